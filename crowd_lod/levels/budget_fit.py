"""Choice of LODs within a budget of each frame: the least tolerance at which agents hold it."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from ..crowd.agents import CLASSES, FEWEST_CLASSES, Group
from ..errors import CrowdError
from ..progress import finished
from .cost_model import Actors, price, stored_triangles, work_of
from .selection import GroupShot, View, least_tolerance

TIGHT = 4.0  # a budget below so many times the least that is guessed may be impossible
SLACK = 1.05  # factor of that tolerance with which fewer LODs are enough


@dataclass(frozen=True)
class Budget:
    """What each frame of a shot may take at most.

    triangles: of all seen agents.
    finest: seen agents at LOD 0; None for any number.
    memory: bytes of the engine, in the frame that takes most.
    """

    triangles: float = inf
    finest: int | None = None
    memory: float = inf


def _megabytes(value: float) -> str:
    """Return bytes in words, rounded up: a limit of that many is kept.

    A millionth less is the same, as a setting's float32 may be.
    """
    return f"{np.ceil(value / 1e5 * (1 - 1e-6)) / 10:,.1f} MB"


# by the field of Budget that limits it: the name of the setting, and how its value reads
LIMITED: dict[str, tuple[str, Callable[[float], str]]] = {
    "triangles": ("Triangles", lambda value: f"{value:,.0f}"),
    "memory": ("Memory", _megabytes),
    "finest": ("Agents at LOD 0", lambda value: f"{value:,.0f}"),
}
# the noun that follows a value in a sentence
COUNTED = {"triangles": " triangles", "memory": "", "finest": " agents at LOD 0"}


@dataclass(frozen=True)
class Sightings:
    """The agents of a group in a shot's frames; those that show about alike large are together.

    frame: (m,) int64, numbers on the timeline.
    scale: (m,) float64, pixels that a meter shows at the agents' nearest part.
    agents: (m,) float64, how many they are.
    character: (m,) intp, which of the group's characters they show.
    lods: (m, 2) intp, the finest and the coarsest LOD that overrides allow them.
    """

    frame: np.ndarray
    scale: np.ndarray
    agents: np.ndarray
    character: np.ndarray
    lods: np.ndarray

    def levels(self, bounds: Sequence[float], tolerance: float) -> np.ndarray:
        """Return the coarsest LODs (m,) that show at most `tolerance` pixels, or are overridden.

        bounds: meters, of each LOD, finest first.
        """
        rising = np.maximum.accumulate(np.asarray(bounds, np.float64)[1:])
        coarsest = (self.scale[:, None] * rising <= tolerance).sum(axis=1)
        return np.clip(coarsest, *self.lods.T).clip(max=len(rising))


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
    lods = [np.broadcast_to(view.lods, (len(view.distance), 2)) for view in known]
    return Sightings(
        np.concatenate([*frames, np.empty(0, np.int64)]),
        np.concatenate([*scales, np.empty(0)]),
        np.concatenate([*counts, np.empty(0)]),
        np.concatenate([*(view.character for view in known), np.empty(0, np.intp)]),
        np.concatenate([*lods, np.empty((0, 2), np.intp)]),
    )


class BudgetSearch:
    """The search for candidates with which the groups hold a budget.

    groups: with values of all their candidates.
    shots: of each group, where its agents are, and what it holds.
    measured: of each group, the candidates whose values are no guesses.
    given: of each group, the candidates that artists made.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        shots: Sequence[GroupShot],
        budget: Budget,
        measured: Sequence[Collection[int]],
        given: Sequence[Collection[int]],
    ):
        self.groups = groups
        self.budget = budget
        self.measured = measured
        self.given = given
        self.shots = shots
        pairs = zip(groups, shots, strict=True)
        self.sightings = [sight(group, shot.views) for group, shot in pairs]
        self.frames = np.unique(np.concatenate([seen.frame for seen in self.sightings]))
        self.every = [_useful(*pair) for pair in zip(groups, given, strict=True)]

    def loads(self, keep: Sequence[Sequence[int]], tolerance: float) -> dict[str, np.ndarray]:
        """Return what the frames take at the least: by a field of Budget, (F,) float64.

        Memory has one value, for all frames, and none without a limit.

        keep: of each group, the candidates that there are.
        """
        loads = {name: np.zeros(len(self.frames)) for name in ("triangles", "finest")}
        memory = np.zeros(1)
        rows = zip(self.groups, self.shots, self.sightings, keep, strict=True)
        for group, shot, seen, candidates in rows:
            level = seen.levels([group.bounds[k] for k in candidates], tolerance)
            frame = np.searchsorted(self.frames, seen.frame)
            columns = {
                "triangles": group.triangles,
                "finest": np.arange(len(group.triangles)) == 0,
            }
            for name, column in columns.items():
                sizes = np.array([column[k] for k in candidates], np.float64)
                np.add.at(loads[name], frame, seen.agents * sizes[level])
            if self.budget.memory < inf:
                few = -(-shot.characters * FEWEST_CLASSES // CLASSES)  # as plans leave
                character = seen.character * FEWEST_CLASSES // CLASSES
                shown = np.zeros((len(self.frames), len(candidates), few), np.intp)
                np.add.at(shown, (frame, level, character), seen.agents.astype(np.intp))
                memory += _memory([group.triangles[k] for k in candidates], shot, shown)
        return loads | ({"memory": memory} if self.budget.memory < inf else {})

    def hold(self, keep: Sequence[Sequence[int]], tolerance: float) -> bool:
        """Return whether all frames hold the budget with these candidates, at this tolerance."""
        return not self.exceeded(keep, tolerance)

    def exceeded(self, keep: Sequence[Sequence[int]], tolerance: float) -> dict[str, float]:
        """Return what the frame takes that takes most, by the field of Budget that it exceeds."""
        worst = {
            name: float(load.max(initial=0.0)) for name, load in self.loads(keep, tolerance).items()
        }
        return {
            name: load
            for name, load in worst.items()
            if (limit := getattr(self.budget, name)) is not None and load > limit
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
        is_near = TIGHT * loads["triangles"].max(initial=0.0) > self.budget.triangles
        return bool(is_near or self.exceeded(self.every, inf))

    def _least_tolerance(self, low: float) -> float:
        """Return the least tolerance at which all candidates together hold the budget, pixels.

        low: pixels, at which they do not.
        """
        pairs = zip(self.groups, self.sightings, strict=True)
        high = max(max(group.bounds) * seen.scale.max(initial=0.0) for group, seen in pairs)
        return finished(least_tolerance(lambda pixels: self.hold(self.every, pixels), low, high))

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


def _memory(triangles: Sequence[int], shot: GroupShot, shown: np.ndarray) -> float:
    """Return the bytes of a group's characters in a bake that shows `shown` (F, K, N) agents.

    triangles: of each of K LODs.
    """
    table = np.array([triangles])
    owner = np.zeros(shown.shape[2], np.intp)
    actors = Actors(table, owner, shot.holdings, stored_triangles(table))
    return price(work_of(actors, shown, known=True), shot.costs).memory


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
        f"The budget is too low for the coarsest LODs that can be made: set {settings} or more in "
        f"Shot > Budget."
    )


def _rounded_up(value: float) -> float:
    """Return `value` with two significant digits, no less."""
    step = 10.0 ** max(np.floor(np.log10(value)) - 1, 0)
    return float(np.ceil(value / step) * step)
