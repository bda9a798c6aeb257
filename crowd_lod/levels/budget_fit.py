"""Choice of LODs within a budget of each frame: the least tolerance at which agents hold it."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from ..crowd.agents import Group
from ..errors import CrowdError
from .selection import View

PRECISE = 1.01  # factor within which the least tolerance is found
TIGHT = 4.0  # a budget below so many times the least that is guessed may be impossible
SLACK = 1.05  # factor of that tolerance with which fewer LODs are enough


@dataclass(frozen=True)
class Budget:
    """What each frame of a shot may take at most.

    triangles, vertices: of all seen agents.
    finest: seen agents at LOD 0; None for any number.
    memory: bytes of the engine, in the frame that takes most.
    """

    triangles: float = inf
    vertices: float = inf
    finest: int | None = None
    memory: float = inf


# by the field of Budget that limits it: the name of the setting, and how its value reads
LIMITED: dict[str, tuple[str, Callable[[float], str]]] = {
    "triangles": ("Triangles", lambda value: f"{value:,.0f}"),
    "memory": ("Memory", lambda value: f"{value / 1e6:,.1f} MB"),
    "finest": ("Agents at LOD 0", lambda value: f"{value:,.0f}"),
}


@dataclass(frozen=True)
class Sightings:
    """The agents of a group in a shot's frames; those that show about alike large are together.

    frame: (m,) int64, numbers on the timeline.
    scale: (m,) float64, pixels that a meter shows at the agents' nearest part.
    agents: (m,) float64, how many they are.
    """

    frame: np.ndarray
    scale: np.ndarray
    agents: np.ndarray

    def levels(self, bounds: Sequence[float], tolerance: float) -> np.ndarray:
        """Return the coarsest LODs (m,) that show at most `tolerance` pixels.

        bounds: meters, of each LOD, finest first.
        """
        rising = np.maximum.accumulate(np.asarray(bounds, np.float64)[1:])
        return (self.scale[:, None] * rising <= tolerance).sum(axis=1)


def sight(group: Group, views: Sequence[View]) -> Sightings:
    """Return the agents of the group in the views that know their distances."""
    known = [view for view in views if len(view.distance)]
    scales = []
    for view in known:
        density = np.full(len(view.distance), view.camera.pixels_per_unit)
        nearest = np.maximum(view.distance - group.radius, max(view.camera.near, 1e-9))
        scales.append(density if view.camera.kind == "ORTHO" else density / nearest)
    counts = [np.broadcast_to(view.agents, view.distance.shape) for view in known]
    frames = [np.full(len(view.distance), view.frame) for view in known]
    return Sightings(
        np.concatenate([*frames, np.empty(0, np.int64)]),
        np.concatenate([*scales, np.empty(0)]),
        np.concatenate([*counts, np.empty(0)]),
    )


class BudgetSearch:
    """The search for candidates with which the groups hold a budget.

    groups: with values of all their candidates. views: of each group, where its agents are.
    measured: of each group, the candidates whose values are no guesses.
    given: of each group, the candidates that artists made.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        views: Sequence[Sequence[View]],
        budget: Budget,
        measured: Sequence[Collection[int]],
        given: Sequence[Collection[int]],
    ):
        self.groups = groups
        self.budget = budget
        self.measured = measured
        self.given = given
        self.sightings = [sight(*pair) for pair in zip(groups, views, strict=True)]
        self.frames = np.unique(np.concatenate([seen.frame for seen in self.sightings]))
        self.every = [_useful(*pair) for pair in zip(groups, given, strict=True)]

    def loads(self, keep: Sequence[Sequence[int]], tolerance: float) -> dict[str, np.ndarray]:
        """Return what the frames take at the least: by a field of Budget, (F,) float64.

        keep: of each group, the candidates that there are.
        """
        triangles = np.zeros(len(self.frames))
        finest = np.zeros(len(self.frames))
        for group, seen, candidates in zip(self.groups, self.sightings, keep, strict=True):
            level = seen.levels([group.bounds[k] for k in candidates], tolerance)
            sizes = np.array([group.triangles[k] for k in candidates], np.float64)
            frame = np.searchsorted(self.frames, seen.frame)
            np.add.at(triangles, frame, seen.agents * sizes[level])
            np.add.at(finest, frame, seen.agents * (level == 0))
        return {"triangles": triangles, "finest": finest}

    def hold(self, keep: Sequence[Sequence[int]], tolerance: float) -> bool:
        """Return whether all frames hold the budget with these candidates, at this tolerance."""
        return not self.exceeded(keep, tolerance)

    def exceeded(self, keep: Sequence[Sequence[int]], tolerance: float) -> dict[str, float]:
        """Return what the frame takes that takes most, by the field of Budget that it exceeds."""
        most = {"triangles": self.budget.triangles, "finest": self.budget.finest}
        worst = {
            name: float(load.max(initial=0.0)) for name, load in self.loads(keep, tolerance).items()
        }
        return {
            name: load
            for name, load in worst.items()
            if (limit := most[name]) is not None and load > limit
        }

    def fit(self, keep: list[list[int]], tolerance: float) -> tuple[list[list[int]], float]:
        """Return (few candidates that hold the budget, the least tolerance at which they do).

        keep: those that were chosen without the budget, which stay if they hold it.
        tolerance: pixels that are allowed anyway.
        CrowdError, which names the setting that would make it possible, if none hold it.
        """
        if self.hold(keep, tolerance):
            return keep, tolerance
        if self._is_tight():  # the coarsest are measured first: what they take is then certain
            coarsest = [candidates[-1] for candidates in self.every]
            if not all(k in known for k, known in zip(coarsest, self.measured, strict=True)):
                return [sorted({0, k}) for k in coarsest], tolerance
        if exceeded := self.exceeded(self.every, inf):
            raise CrowdError(_impossible(exceeded))
        if not self.hold(self.every, tolerance):
            tolerance = SLACK * self._least_tolerance(tolerance)
        return self._pruned(tolerance), tolerance

    def _is_tight(self) -> bool:
        """Return whether the coarsest candidates may be needed, or not even be enough."""
        loads = self.loads(self.every, inf)
        triangles = float(loads["triangles"].max(initial=0.0))
        return TIGHT * triangles > self.budget.triangles or bool(self.exceeded(self.every, inf))

    def _least_tolerance(self, low: float) -> float:
        """Return the least tolerance at which all candidates together hold the budget, pixels.

        low: pixels, at which they do not.
        """
        pairs = zip(self.groups, self.sightings, strict=True)
        high = max(max(group.bounds) * seen.scale.max(initial=0.0) for group, seen in pairs)
        while high > PRECISE * low:
            middle = float(np.sqrt(low * high))
            if self.hold(self.every, middle):
                high = middle
            else:
                low = middle
        return high

    def _pruned(self, tolerance: float) -> list[list[int]]:
        """Return the candidates without those that frames need not to hold the budget.

        The first to go are those that are not measured yet, and those that save least. The
        characters, and LODs that artists gave, stay.
        """
        keep = [list(candidates) for candidates in self.every]
        while True:
            choices = []
            for g, candidates in enumerate(keep):
                for k in set(candidates[1:]).difference(self.given[g]):
                    fewer = [
                        *keep[:g],
                        [other for other in candidates if other != k],
                        *keep[g + 1 :],
                    ]
                    loads = self.loads(fewer, tolerance)
                    if self.hold(fewer, tolerance):
                        order = (k in self.measured[g], float(loads["triangles"].sum()), g, k)
                        choices.append((order, fewer))
            if not choices:
                return keep
            _, keep = min(choices)


def _useful(group: Group, given: Collection[int]) -> list[int]:
    """Return the candidates, of which each has fewer triangles than all that deviate less."""
    candidates = [0]
    for k in range(1, len(group.triangles)):
        if k in given or group.triangles[k] < min(group.triangles[j] for j in candidates):
            candidates.append(k)
    return candidates


def _impossible(exceeded: dict[str, float]) -> str:
    """Return a sentence that names the settings with which a budget is possible."""
    least = {name: _rounded_up(value) for name, value in exceeded.items()}
    settings = " and ".join(
        f"{LIMITED[name][0]} to {LIMITED[name][1](value)}" for name, value in least.items()
    )
    return (
        f"The budget is impossible with the coarsest LODs that can be made: in the panel Budget "
        f"set {settings} or more."
    )


def _rounded_up(value: float) -> float:
    """Return `value` with two significant digits, no less."""
    step = 10.0 ** max(np.floor(np.log10(value)) - 1, 0)
    return float(np.ceil(value / step) * step)
