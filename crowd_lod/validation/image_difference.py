"""Differences of two pictures, and the predicted shift of silhouettes by LODs."""

from dataclasses import dataclass

import numpy as np

from ..levels.assignment import shown
from ..planning.frame import Frame

TOUCHED, SOLID = 1e-6, 0.5  # coverage of a pixel
FARTHEST = 64  # pixels that a silhouette's shift is followed
VISIBLE = 2 / 255


@dataclass(frozen=True)
class Difference:
    """The difference of two pictures.

    pixels: how many differ in value at all.
    visible: how many differ by more than VISIBLE in a linear channel.
    share: the visible ones' part of the picture.
    largest, mean, rms: of the absolute difference, over pixels and channels.
    """

    pixels: int
    visible: int
    share: float
    largest: float
    mean: float
    rms: float


def between(a: np.ndarray, b: np.ndarray) -> Difference:
    """Return the difference of two linear pictures (rows, columns, channels) float32.

    Values are equal if they compare equal, or if both are NaN.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(a - b)
    off[(a == b) | (np.isnan(a) & np.isnan(b))] = 0
    off[np.isnan(off)] = np.inf
    most = off.max(axis=2)
    visible = int((most > VISIBLE).sum())
    finite = np.minimum(off, np.finfo(np.float32).max)
    mean, rms = finite.mean(dtype=np.float64), np.sqrt(np.square(finite, dtype=np.float64).mean())
    return Difference(int((most > 0).sum()), visible, visible / most.size, float(finite.max()), float(mean), float(rms))


def shift(a: np.ndarray, b: np.ndarray) -> float:
    """Return by how many pixels two silhouettes lie apart, FARTHEST at most.

    This is the largest distance from a pixel that one covers by half or more to the nearest pixel
    that the other touches, both ways. A shift of s pixels shows as s - 1 to s + 1.
    a, b: (rows, columns) float in [0, 1], the coverage of each pixel.
    """
    return max(_beyond(a, b), _beyond(b, a))


def _beyond(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest distance in pixels from a solid pixel of `one` to `other`."""
    rest, touched = one >= SOLID, other > TOUCHED
    around = np.arange(-FARTHEST, FARTHEST + 1)
    dx, dy = (each.ravel() for each in np.meshgrid(around, around))
    distance = np.hypot(dx, dy)
    rows, columns = np.nonzero(rest)
    order = np.argsort(distance, kind="stable")
    for k in order[: np.searchsorted(distance[order], FARTHEST, side="right")]:
        y, x = rows + dy[k], columns + dx[k]
        inside = (y >= 0) & (y < one.shape[0]) & (x >= 0) & (x < one.shape[1])
        left = np.ones(len(rows), bool)
        left[inside] = ~touched[y[inside], x[inside]]
        rows, columns = rows[left], columns[left]
        if not len(rows):
            return float(distance[k])
    return float(FARTHEST)


def predicted(frame: Frame) -> float | None:
    """Return by how many pixels LODs may shift the silhouettes of the visible agents.

    It follows from the groups' bounds of deviation, against LOD 0: the largest `shown`
    (levels/assignment.py) at the nearest place of a LOD's surface, times sqrt(1 + s^2) at the slope
    s of the picture's corner. A point at p that moves by e to the depth z' moves by (e.XY - s e.Z)
    / z' in the picture.
    None if a deviation is not measured, if no distance bounds it, or if a lens bends the picture.
    """
    agents, camera, groups = frame.buckets.order, frame.camera, frame.trajectory.groups
    group, level = frame.crowd.group[agents], frame.buckets.levels
    if camera.kind == "PANO" or not all(len(groups[g].bounds) > level[group == g].max() for g in np.unique(group)):
        return None
    off = np.array([groups[g].bounds[k] for g, k in zip(group.tolist(), level.tolist(), strict=True)])
    pixels = float(shown(off, frame.depths[agents], camera, frame.trajectory.spheres.radius[group] + off).max(initial=0.0))
    w = camera.window
    slope = 0.0 if camera.kind == "ORTHO" else np.hypot(max(abs(w.left), abs(w.right)), max(abs(w.bottom), abs(w.top)))
    return pixels * float(np.sqrt(1 + slope**2)) if np.isfinite(pixels) else None
