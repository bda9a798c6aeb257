"""Which spheres opaque scenery hides from a camera: their rectangles on the map of depths.

Source: hierarchical depth maps (Greene, Kass, Miller 1993), here of the least nearness.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .camera import Camera, stretch
from .depth_map import map_depths
from .frustum import reach_of
from .occluders import Occluders
from .sheets import Grid, grid_of, nearest_cut, view_points

SPAN = 3  # cells of a level that a rectangle spans, at most one more
FAR_OFF = 1e9  # cells


@dataclass(frozen=True)
class Rectangles:
    """The parts of the picture in which m bodies may be seen.

    low, high: (m, 2) cells.
    nearness: (m,), of their nearest points; inf if they reach before the camera's near clip.
    """

    low: np.ndarray
    high: np.ndarray
    nearness: np.ndarray

    def joined(self, other: "Rectangles") -> "Rectangles":
        """Return the rectangles of the convex hulls of these bodies and the others."""
        return Rectangles(
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
            np.maximum(self.nearness, other.nearness),
        )


class OcclusionMap:
    """What scenery hides from one camera."""

    def __init__(self, occluders: Occluders, camera: Camera, neighbors: Sequence[Camera] = ()):
        """Draw the map.

        camera: PERSP or ORTHO, without lens blur.
        neighbors: the same camera at the times before and after (see depth_map.map_depths).
        """
        self.cameras = (camera, *neighbors)
        self.grid: Grid = grid_of(camera)
        self.levels = [map_depths(occluders, camera, neighbors)]
        while min(self.levels[-1].shape) > 1:
            self.levels.append(_halved(self.levels[-1]))

    @property
    def is_empty(self) -> bool:
        """Whether it hides nothing."""
        return not np.isfinite(self.levels[0]).any()

    def rectangles(self, points: np.ndarray, radius: np.ndarray) -> Rectangles:
        """Return the rectangles of spheres.

        points: (m, 3) meters, their centers.
        radius: (m,) meters.
        """
        body, *elsewhere = (
            _rectangles(points, radius, each, self.grid.of_camera(each)) for each in self.cameras
        )
        for rectangles in elsewhere:
            body = body.joined(rectangles)
        return body

    def hides(self, bodies: Rectangles) -> np.ndarray:
        """Return which of m bodies no ray of the camera meets, (m,) bool.

        What lies beside the picture counts as hidden.
        """
        filtered = 1 / np.array(self.cameras[0].pixels) * self.grid.size  # a pixel, in cells
        most = self.grid.size - 1
        low = np.clip(np.floor(bodies.low - filtered), 0, most).astype(np.intp)
        high = np.clip(np.floor(bodies.high + filtered), 0, most).astype(np.intp)
        wide = (high - low).max(axis=1, initial=0)
        level = np.ceil(np.log2(np.maximum(wide / SPAN, 1))).astype(np.intp)
        level = np.minimum(level, len(self.levels) - 1)
        least = np.full(len(level), np.inf)
        for k in np.flatnonzero(np.bincount(level)):
            rows = np.flatnonzero(level == k)
            least[rows] = _least(self.levels[k], low[rows] >> k, high[rows] >> k)
        return bodies.nearness < least


def _rectangles(points: np.ndarray, radius: np.ndarray, camera: Camera, grid: Grid) -> Rectangles:
    """Return the rectangles of spheres in the picture of one camera."""
    v = view_points(points, camera)
    reach, slack = reach_of(camera, tuple(v.T), np.zeros(0), radius)
    reach = ((reach + slack) * stretch(camera)[1])[:, None]
    depth = v[:, 2:]
    nearest = depth - reach
    if camera.kind == "ORTHO":
        low = v[:, :2] - reach
        high = v[:, :2] + reach
        nearness = -nearest[:, 0]
    else:
        # slopes of the tangents: (x z -+ r sqrt(x^2 + z^2 - r^2)) / (z^2 - r^2)
        ahead = nearest > 0
        square = np.where(ahead, depth**2 - reach**2, 1.0)
        root = reach * np.sqrt(np.maximum(v[:, :2] ** 2 + square, 0))
        low = np.where(ahead, (v[:, :2] * depth - root) / square, -FAR_OFF)
        high = np.where(ahead, (v[:, :2] * depth + root) / square, FAR_OFF)
        nearness = 1 / np.where(ahead, nearest, 1.0)[:, 0]
    nearness = np.where(nearest[:, 0] > nearest_cut(camera), nearness, np.inf)
    return Rectangles(
        np.maximum((low - grid.low) * grid.scale, -FAR_OFF),
        np.minimum((high - grid.low) * grid.scale, FAR_OFF),
        nearness,
    )


def _halved(level: np.ndarray) -> np.ndarray:
    """Return the least of each four cells, (ceil(rows / 2), ceil(columns / 2))."""
    rows, columns = level.shape
    even = np.pad(level, ((0, rows % 2), (0, columns % 2)), mode="edge")
    pairs = np.minimum(even[::2], even[1::2])
    return np.minimum(pairs[:, ::2], pairs[:, 1::2])


def _least(level: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the least of the cells from `low` to `high` (m, 2), column and row, of a level."""
    least = np.full(len(low), np.inf)
    across, up = (high - low).max(axis=0)
    for row in range(up + 1):
        rows = np.minimum(low[:, 1] + row, high[:, 1])
        for column in range(across + 1):
            columns = np.minimum(low[:, 0] + column, high[:, 0])
            np.minimum(least, level[rows, columns], out=least)
    return least
