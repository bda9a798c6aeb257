"""Which bodies opaque scenery hides from a camera: their rectangles on the map of depths."""

from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np

from .camera import Camera, stretch
from .depth_map import RectangleMinima, map_depths
from .frustum import reach_of
from .occluders import Occluders
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

    def among(self, rows: np.ndarray) -> "Rectangles":
        """Return the rectangles of these bodies, (k,) indices."""
        return Rectangles(self.low[rows], self.high[rows], self.nearness[rows])

    def common(self, other: "Rectangles") -> "Rectangles":
        """Return the rectangles of what these bodies and the others have in common."""
        return Rectangles(
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
            np.minimum(self.nearness, other.nearness),
        )

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
        return reduce(
            Rectangles.joined,
            (_of_spheres(points, radius, each, self.grid.of_camera(each)) for each in self.cameras),
        )

    def hides_agents(self, points: np.ndarray, radius: np.ndarray, girth: np.ndarray) -> np.ndarray:
        """Return which agents no ray of the camera meets, (m,) bool.

        points, radius: of their spheres, as in `rectangles`.
        girth: (m,) meters, how far they reach from the vertical axis through `points`.
        """
        spheres = self.rectangles(points, radius)
        hidden = self.hides(spheres)
        rest = np.flatnonzero(~hidden & (girth < radius))
        bodies = reduce(
            Rectangles.joined,
            (
                _of_boxes(points[rest], radius[rest], girth[rest], each, self.grid.of_camera(each))
                for each in self.cameras
            ),
        )
        hidden[rest] = self.hides(bodies.common(spheres.among(rest)))
        return hidden

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


def _of_spheres(points: np.ndarray, radius: np.ndarray, camera: Camera, grid: Grid) -> Rectangles:
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


def _of_boxes(
    points: np.ndarray, radius: np.ndarray, girth: np.ndarray, camera: Camera, grid: Grid
) -> Rectangles:
    """Return the rectangles of upright boxes in the picture of one camera.

    points: (m, 3) meters, their centers.
    radius, girth: (m,) meters, half of their heights and of their other sides. These run along the
        picture and away from it, and hold the agent at any heading.
    """
    v = view_points(points, camera)
    reach, slack = reach_of(camera, tuple(v.T), np.zeros(0), radius)
    up = reach + slack
    aside = girth + (up - radius)
    yaw = np.arctan2(camera.X[1], camera.X[0])
    level = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    sides = np.stack([aside, aside, up], axis=1)[:, :, None] * (
        level @ np.array([camera.X, camera.Y, camera.Z]).T
    )
    corners = v + np.array(
        [np.einsum("k,mkd->md", signs, sides) for signs in product((-1, 1), repeat=3)]
    )
    depth = corners[..., 2]
    ahead = (depth > nearest_cut(camera)).all(axis=0)
    flat = corners[..., :2]
    nearness = -depth
    if camera.kind != "ORTHO":
        depth = np.where(ahead, depth, 1.0)
        flat = flat / depth[..., None]
        nearness = 1 / depth
    flat = (flat - grid.low) * grid.scale
    return Rectangles(
        np.where(ahead[:, None], flat.min(axis=0), -FAR_OFF),
        np.where(ahead[:, None], flat.max(axis=0), FAR_OFF),
        np.where(ahead, nearness.max(axis=0), np.inf),
    )
