"""Which spheres opaque scenery hides from a camera: their rectangles on the map of depths."""

from dataclasses import dataclass

import numpy as np

from .camera import Camera, stretch
from .depth_map import map_depths
from .frustum import reach_of
from .occluders import Occluders
from .rectangle_minima import RectangleMinima
from .sheets import Grid, grid_of, nearest_cut, view_points

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

    def __init__(self, occluders: Occluders, *cameras: Camera):
        """Draw the map.

        cameras: PERSP or ORTHO, without lens blur; one, or one at the begin and the end of a time
            (see depth_map.map_depths).
        """
        self.cameras = cameras
        self.grid: Grid = grid_of(cameras[0])
        self.nearness = map_depths(occluders, cameras)
        self._least = RectangleMinima(self.nearness)

    @property
    def is_empty(self) -> bool:
        """Whether it hides nothing."""
        return not np.isfinite(self.nearness).any()

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
        hidden: np.ndarray = bodies.nearness < self._least.of(low, high)
        return hidden


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
