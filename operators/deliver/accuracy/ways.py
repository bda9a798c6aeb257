"""The ways to render a crowd that are compared: full detail, by distance, by tolerance, planned."""

from dataclasses import dataclass

import numpy as np

from ....crowd_lod.levels.assignment import LEAST_GAP, deviations
from ....crowd_lod.output.accuracy_sections import EVERYONE, NOBODY, TOLERANCE
from ...scene.characters.stored_groups import groups_of
from ...scene.scene_crowd import policy_of
from ...scene.shot_reference import path_of

# kinds of ways, beside those that verdicts name
CULLED = "full detail, culled"
DISTANCE = "by distance, at thirds"
AS_SET = "by distance, as set"
PLANNED = "with a shot plan"
TOLERANCES = 0.25, 0.5, 1.0, 2.0, 4.0, 8.0  # pixels
FEW_TOLERANCES = (4.0,)


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
        if self.kind == TOLERANCE:
            return f"{self.tolerance:g} px"
        if self.kind == PLANNED and self.tolerance is not None:
            return f"{self.tolerance:g} px, {PLANNED}"
        return self.kind


def ways_of(settings, is_quick: bool) -> list[RenderWay]:
    """Return the ways that the scene with these settings has; LOD meshes are made.

    LODs without a measured deviation have no tolerances.
    """
    ways = [RenderWay(NOBODY), RenderWay(EVERYONE), RenderWay(CULLED)]
    if _lods_made(settings) >= 2:
        ways.append(RenderWay(DISTANCE))
    own = policy_of(settings)
    is_planned = path_of(settings) is not None
    if own.tolerance is None:
        ways.append(RenderWay(AS_SET, is_default=not is_planned))
    measured = deviations(groups_of(settings), policy_of(settings, "BY_TOLERANCE")) is not None
    wanted = set(FEW_TOLERANCES if is_quick else TOLERANCES) if measured else set()
    if own.tolerance is not None:
        wanted.add(own.tolerance)
    ways += [
        RenderWay(TOLERANCE, each, each == own.tolerance and not is_planned)
        for each in sorted(wanted)
    ]
    if is_planned or (own.tolerance is not None and not is_quick):
        ways.append(RenderWay(PLANNED, own.tolerance, is_planned))
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

    The LODs between them get next to nothing, LEAST_GAP each.
    """
    middle = count // 2
    number = np.arange(1, count)
    last = np.where(number <= middle, middle, count - 1)
    third = np.where(number <= middle, 1 / 3, 2 / 3)
    thresholds: np.ndarray = third - LEAST_GAP * (last - number)
    return thresholds


def _by_distance(settings, thresholds: np.ndarray) -> None:
    """Give the settings LODs that begin at these thresholds, (n - 1,)."""
    settings.choice = "BY_DISTANCE"
    settings.level_count = len(thresholds) + 1
    for group in settings.groups:
        group.use_custom_thresholds = False
    settings.thresholds[: len(thresholds)] = thresholds
