"""The ways to render a crowd that are compared: full detail, by distance, by tolerance, planned."""

from dataclasses import dataclass

import numpy as np

from ....crowd_lod.levels.assignment import deviations, pushed
from ....crowd_lod.output.accuracy_sections import EVERYONE, NOBODY, TOLERANCE
from ....crowd_lod.validation.behavior_errors import RATES
from ....crowd_lod.validation.timing import FEWEST
from ...scene.characters.stored_groups import groups_of
from ...scene.scene_crowd import policy_of
from ...scene.shot_reference import path_of

# kinds of ways, beside those that verdicts name
CULLED = "full detail, culled"
DISTANCE = "by distance, at thirds"
AS_SET = "by distance, as set"
PLANNED = "with a shot plan"


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    frames, repeats: that are rendered, and how often. width, samples: of their pictures, at most.
    tolerances: pixels, beside the scene's own. plans: whether a scene without a shot plan gets one.
    length: frames that behavior is followed for. rates: steps a second of its ways.
    counts: agents that are culled.
    runs: of each way of behavior and culling, at least.
    """

    frames: int = 3
    repeats: int = 3
    width: int = 640
    samples: int = 8
    tolerances: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
    plans: bool = True
    length: int = 120
    rates: tuple[int, ...] = RATES
    counts: tuple[int, ...] = (1000, 10_000, 100_000, 1_000_000)
    runs: int = FEWEST


THOROUGH = Effort()
QUICK = Effort(1, 1, 480, 4, (4.0,), False, 48, RATES[:2], THOROUGH.counts[:3], 2)


@dataclass(frozen=True)
class RenderWay:
    """A way to render the crowd.

    tolerance: pixels, of LODs by tolerance.
    is_default: whether the scene is set so.
    """

    kind: str
    tolerance: float | None = None
    is_default: bool = False

    @property
    def title(self) -> str:
        if self.tolerance is None:
            return self.kind
        return f"{self.tolerance:g} px" + f", {PLANNED}" * (self.kind == PLANNED)


def ways_of(settings, effort: Effort) -> list[RenderWay]:
    """Return the ways that the scene with these settings has; LOD meshes are made.

    LODs without a measured deviation have no tolerances.
    """
    own = policy_of(settings).tolerance
    is_planned = path_of(settings) is not None
    measured = deviations(groups_of(settings), policy_of(settings, "BY_TOLERANCE")) is not None
    tolerances = set(effort.tolerances if measured else ()) | ({own} - {None})
    ways = [RenderWay(NOBODY), RenderWay(EVERYONE), RenderWay(CULLED)]
    if _lods_made(settings) >= 2:
        ways.append(RenderWay(DISTANCE))
    if own is None:
        ways.append(RenderWay(AS_SET, is_default=not is_planned))
    for each in sorted(tolerances):
        ways.append(RenderWay(TOLERANCE, each, each == own and not is_planned))
    if is_planned or (own is not None and effort.plans):
        ways.append(RenderWay(PLANNED, own, is_planned))
    return ways


def set_way(settings, way: RenderWay) -> None:
    """Set the scene's settings so that it builds the crowd in this way; a shot plan stays."""
    settings.use_shot_plan &= way.kind == PLANNED
    if way.kind in (NOBODY, EVERYONE, CULLED):
        _by_distance(settings, np.empty(0))
    elif way.kind == DISTANCE:
        _by_distance(settings, at_thirds(_lods_made(settings)))
    elif way.kind == TOLERANCE and way.tolerance != policy_of(settings).tolerance:
        settings.choice = "BY_TOLERANCE"
        settings.tolerance = way.tolerance
        settings.memory_tolerance = 0


def _lods_made(settings) -> int:
    """Return how many LODs all characters have; collections of more may be left from before."""
    return min((sum(n > 0 for n in group.triangles) for group in settings.groups), default=0)


def at_thirds(count: int) -> np.ndarray:
    """Return thresholds (count - 1,) by which the first, the middle and the last LOD take a third.

    The LODs between them get next to nothing.
    """
    thirds = np.repeat([1 / 3, 2 / 3], [count // 2, count - 1 - count // 2])
    return pushed(thirds.tolist(), count - 2)


def _by_distance(settings, thresholds: np.ndarray) -> None:
    """Give the settings LODs that begin at these thresholds, (n - 1,)."""
    settings.choice = "BY_DISTANCE"
    settings.level_count = len(thresholds) + 1
    for group in settings.groups:
        group.use_custom_thresholds = False
    settings.thresholds[: len(thresholds)] = thresholds
