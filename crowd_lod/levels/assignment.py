"""LOD from distance: a sum of unit steps (chapter eq 1.7, listing 1.4)."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Group
from ..culling.camera import Camera
from ..errors import CrowdError
from ..world.maps import Area

MOST_LEVELS = 8
LEAST_GAP = 0.001  # between thresholds that push each other along, and from 0 to the first


@dataclass(frozen=True)
class LevelPolicy:
    """How LODs follow from distance.

    thresholds: n - 1 values, where LODs 1 ... n - 1 begin. Parts of the far distance, strictly
        increasing in (0, 1]. Distances are along the view (the chapter's v.Z); of a panoramic
        camera, from it.
    margin: None derives the widening of the frustum. A number is the chapter's fixed Delta, meters.
    tolerance: pixels. A LOD then begins where its measured deviation shows no more than that, so
        that a zoom changes it, and the thresholds only count the LODs.
    group_thresholds: one entry per group: its own thresholds, or () if it has none.
    finest: for each group the finest LOD that it has; () if each has all.
    CrowdError names the value that is wrong.
    """

    thresholds: tuple[float, ...]
    margin: float | None = None
    tolerance: float | None = None
    group_thresholds: tuple[tuple[float, ...], ...] = ()
    finest: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.margin is not None and not 0 <= self.margin < np.inf:
            raise CrowdError(
                f"The fixed margin is {self.margin} m; it must be finite and at least 0."
            )
        if self.tolerance is not None and not 0 < self.tolerance < np.inf:
            raise CrowdError(
                f"The LOD tolerance is {self.tolerance} pixels; it must be finite and above 0."
            )
        if len(self.thresholds) >= MOST_LEVELS:
            raise CrowdError(
                f"There are {len(self.thresholds) + 1} levels of detail; use 1 to {MOST_LEVELS}."
            )
        self._check(self.thresholds, "")
        for number, thresholds in enumerate(self.group_thresholds):
            if thresholds and len(thresholds) != len(self.thresholds):
                raise CrowdError(
                    f"Character group {number} has {len(thresholds)} LOD thresholds of its own; "
                    f"give it {len(self.thresholds)}, as many as the others have, or none."
                )
            self._check(thresholds, f" of character group {number}")

    def _check(self, thresholds: tuple[float, ...], of_group: str) -> None:
        if self.tolerance is not None:
            return
        before = 0.0
        for number, threshold in enumerate(thresholds):
            if not before < threshold <= 1:
                raise CrowdError(
                    f"LOD threshold {number}{of_group} is {threshold:g}; thresholds must increase "
                    f"strictly within (0, 1], and the one before is {before:g}."
                )
            before = threshold

    @property
    def count(self) -> int:
        """The number of LODs."""
        return len(self.thresholds) + 1


def pushed(values: Sequence[float], fixed: int) -> np.ndarray:
    """Return thresholds (k,) float64 that LevelPolicy takes, as near as can be to `values` (k,).

    The value at index `fixed` stays, and pushes the others along as far as it must, each LEAST_GAP
    from the next. Where no room is left for them, it stops itself. Values that are in order stay to
    the bit.
    """
    with suppress(CrowdError):
        LevelPolicy(tuple(round(value, 6) for value in values))
        return np.array(values, np.float64)
    gaps = LEAST_GAP * np.arange(len(values))
    rising = np.array(values, np.float64) - gaps
    rising[fixed:] = np.maximum.accumulate(rising[fixed:])
    rising[fixed::-1] = np.minimum.accumulate(rising[fixed::-1])
    return rising.clip(LEAST_GAP, 1 - gaps[-1]) + gaps


def threshold_distances(
    policy: LevelPolicy, camera: Camera, radius: np.ndarray, deviation: np.ndarray | None = None
) -> np.ndarray:
    """Return the thresholds in meters: where each group's LODs 1 ... n - 1 begin.

    (G, n - 1) float64, meters, never decreasing along a row. With p pixels per unit slope, a length
    e shows e p / d pixels at the distance d in the middle of the picture, and sqrt(1 + s^2) of that
    at a slope s from it. An agent's nearest part is up to its radius nearer than its center. An
    orthographic camera shows e p pixels at any distance: a LOD then begins at -infinity, or never.
    radius: (G,) meters, of the bounding spheres.
    deviation: (G, n) meters, of each LOD's surface from the full mesh. A tolerance needs it.
    CrowdError if the policy has a tolerance and there is no deviation.
    """
    groups = len(radius)
    count = len(policy.thresholds)
    # a LOD that is the group's finest begins anywhere
    is_finest = np.arange(count) < np.array(policy.finest or (0,))[:, None]
    own = dict(enumerate(policy.group_thresholds))
    rows = [own.get(g) or policy.thresholds for g in range(groups)]
    thresholds = np.array(rows, np.float64).reshape(groups, count)
    if policy.tolerance is None or not count:
        return np.where(is_finest, -np.inf, camera.far * thresholds)
    if deviation is None:
        raise CrowdError(
            "A LOD tolerance needs the measured LOD meshes: make them, or choose LODs by distance."
        )
    pixels_shown = camera.pixels_per_unit * deviation[:, 1:]
    distances = (
        np.where(pixels_shown <= policy.tolerance, -np.inf, np.inf)
        if camera.kind == "ORTHO"
        else pixels_shown / policy.tolerance + radius[:, None]
    )
    return np.maximum.accumulate(np.where(is_finest, -np.inf, distances), axis=1)


def pixels_of(
    deviation: np.ndarray | float,
    distance: np.ndarray | float,
    camera: Camera,
    radius: np.ndarray | float,
) -> np.ndarray:
    """Return the pixels that a deviation shows at most: the inverse of
    `threshold_distances`.

    Infinite if the camera is inside the bounding sphere and the deviation is not 0.
    deviation, distance, radius: meters; the radius is that of the agent's bounding sphere.
    """
    length = camera.pixels_per_unit * np.asarray(deviation, np.float64)
    if camera.kind == "ORTHO":
        return length
    nearest = np.asarray(distance - radius, np.float64)
    return np.where(
        nearest > 0, length / np.where(nearest > 0, nearest, 1.0), np.where(length > 0, np.inf, 0.0)
    )


def assign(
    distance: np.ndarray,
    thresholds: np.ndarray,
    group: np.ndarray | None = None,
    factor: np.ndarray | None = None,
) -> np.ndarray:
    """Return the LOD ids (n,) uint8, 0 the finest.

    An id is the sum of U(distance - threshold_i), with U(0) = 1.
    distance: (n,) float64, meters.
    thresholds: meters, (n - 1,) for all agents, or (G, n - 1) with `group`.
    group: (n,) uint8.
    factor: (n,) or None, multiplies each agent's distance (see `Bias`).

    Rounding: the distance from culling/radar.py errs by at most ROUNDING (|vx| + |vy| + |vz| +
        |camera's z|) |Z|, with |Z| = 1 unless the camera is sheared. The factor and the threshold
        add eps each. So an id can differ from exact arithmetic only if factor x distance lies near
        a threshold: within that error times the factor, plus eps (factor x distance + threshold).
    """
    if factor is not None:
        distance = distance * factor
    ids = np.zeros(len(distance), np.uint8)
    for threshold in np.asarray(thresholds).T:
        if threshold.ndim and len(threshold) > 1 and (threshold != threshold[0]).any():
            threshold = threshold[group]
        elif threshold.ndim:
            threshold = threshold[0]
        ids += (distance >= threshold).view(np.uint8)  # bools would be cast one by one
    return ids


@dataclass(frozen=True)
class Bias:
    """A painted layer over an area that says where detail matters.

    values: (rows, columns) float in [0, 1]. Row 0 lies at y_min, column 0 at x_min. 0.5 changes
        nothing. At 1 an agent has the LOD of one four times as near, at 0 of one four times as far.
    CrowdError if a value is outside 0 to 1.
    """

    values: np.ndarray
    area: Area

    def __post_init__(self) -> None:
        if not ((self.values >= 0) & (self.values <= 1)).all():
            raise CrowdError(
                "The LOD bias map holds values outside 0 to 1: paint it between black and white."
            )

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return factors (n,) float64 on the distances of agents at x, y (n,).

        Outside the area the nearest cell counts.
        """
        rows, columns = self.values.shape
        width, depth = self.area.size
        with np.errstate(invalid="ignore"):  # agents at NaN, dropped elsewhere
            column = (
                np.nan_to_num((x - self.area.x_min) * (columns / width))
                .clip(0, columns - 1)
                .astype(np.intp)
            )
            row = (
                np.nan_to_num((y - self.area.y_min) * (rows / depth))
                .clip(0, rows - 1)
                .astype(np.intp)
            )
        return 4.0 ** (1 - 2 * self.values[row, column].astype(np.float64))


def deviations(groups: Sequence[Group], policy: LevelPolicy) -> np.ndarray | None:
    """Return how far each group's LODs deviate at most; None if one is not measured.

    (G, n) float64, meters. Infinite for LODs that repeat the group's last: they never begin. By
    tolerance, an entry is at least the tolerance times Group.shaded: the length that shows as many
    pixels as the tolerance at the distance from which on the LOD's colors are good enough.
    """
    count = policy.count
    if not all(len(group.bounds) >= count for group in groups):
        return None
    table = np.array([group.bounds[:count] for group in groups], np.float64)
    for row, group in zip(table, groups, strict=True):
        row[_lods_of_its_own(group, count) :] = np.inf
    if policy.tolerance is not None:
        for row, group in zip(table, groups, strict=True):
            shaded = policy.tolerance * np.array(group.shaded[:count])
            row[: len(shaded)] = np.maximum(row[: len(shaded)], shaded)
    return table


def _lods_of_its_own(group: Group, count: int) -> int:
    """Return how many of `count` LODs the group has of its own; the others repeat the last of
    them.
    """
    rows = [*zip(group.triangles[:count], group.bounds[:count], strict=False)]
    if len(rows) < count:
        return count
    return max((k for k in range(1, count) if rows[k] != rows[k - 1]), default=0) + 1
