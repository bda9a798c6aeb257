"""Surfaces that move: the same triangles in several poses, and what points of another map to."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .closest_point import closest_weights
from .triangle_mesh import TriangleMesh


@dataclass
class MovingSurface:
    """A surface in k poses.

    points: (n, k, 3) float64 meters; triangles: (m, 3) indices.
    find(pose, points (j, 3)): the triangles (j,) closest to the points in that pose.
    counted: (m,) bool, the triangles whose distance from another surface counts; None if all do.
    """

    points: np.ndarray
    triangles: np.ndarray
    find: Callable[[int, np.ndarray], np.ndarray]
    counted: np.ndarray | None = None

    @property
    def pieces(self) -> np.ndarray:
        """The triangles (p, 3) whose distance counts."""
        return self.triangles if self.counted is None else self.triangles[self.counted]

    def on(self, faces: np.ndarray, points: np.ndarray, pose: int) -> np.ndarray:
        """Barycentric weights (j, 3) of the points of faces closest to `points` (j, 3).

        faces: (j,); in the given pose.
        """
        return closest_weights(points.T, *self.corners(faces, pose)).T

    def corners(self, faces: np.ndarray, pose: int) -> list[np.ndarray]:
        """The corners of the triangles `faces` (j,) in the pose, three times (3, j)."""
        return [self.points[self.triangles[faces, c], pose].T for c in range(3)]

    def mesh(self, pose: int) -> TriangleMesh:
        """The surface in the pose."""
        return self.rest.moved(np.ascontiguousarray(self.points[:, pose].T))

    @cached_property
    def rest(self) -> TriangleMesh:
        """The surface in the first pose."""
        return TriangleMesh(self.points[:, 0].T, np.ascontiguousarray(self.triangles.T))


@dataclass
class Target:
    """A surface in some of its poses, to which points and pieces of another are mapped.

    Maps are found in the first of the poses, the base.
    """

    surface: MovingSurface
    poses: slice

    @property
    def base(self) -> int:
        return self.poses.start

    @property
    def base_alone(self) -> slice:
        """The base as poses."""
        return slice(self.base, self.base + 1)

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The surface in the base."""
        return self.surface.mesh(self.base)

    def on(self, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Weights (j, 3) of the points of faces (j,) closest to `points` (j, 3) in the base."""
        return self.surface.on(faces, points, self.base)

    def mix(self, corners: np.ndarray, weights: np.ndarray, poses: slice) -> np.ndarray:
        """The points (j, poses, 3) at weights (j, 3) of the surface's points (j, 3)."""
        points = self.surface.points
        return sum(points[corners[:, c], poses] * weights[:, c, None, None] for c in range(3))


def length_of(vectors: np.ndarray) -> np.ndarray:
    """The lengths (...) of vectors (..., 3)."""
    return np.sqrt(np.einsum("...d,...d->...", vectors, vectors))
