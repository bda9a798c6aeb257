"""Surfaces of triangles: the nearest points on one, samples of one, the distance between two."""

from functools import cached_property

import numpy as np
from mathutils.bvhtree import BVHTree

SAMPLES = 20_000  # points over each surface, besides its vertices, that a distance between two is measured at
FLAT = 1e-6  # a triangle's height as part of its longest side, up to which nothing of it shows


class Surface:
    """A surface of triangles that can be asked for nearest points. points: (n, 3) metres; triangles: (m, 3) indices.

    Blender's tree keeps float32: it is built about the middle of the points.
    """

    def __init__(self, points: np.ndarray, triangles: np.ndarray):
        self.points, self.triangles = np.asarray(points, np.float64), np.asarray(triangles)
        self.middle = (self.points.min(axis=0) + self.points.max(axis=0)) / 2

    @cached_property
    def tree(self) -> BVHTree:
        return BVHTree.FromPolygons((self.points - self.middle).tolist(), self.triangles.tolist())

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(at (k, 3) metres, triangle (k,) intp, distance (k,) metres) of the surface's points nearest to points (k, 3)."""
        hits = [self.tree.find_nearest(p) for p in (points - self.middle).tolist()]
        at = np.array([hit[0] for hit in hits], np.float64).reshape(-1, 3) + self.middle
        return at, np.array([hit[2] for hit in hits], np.intp), np.array([hit[3] for hit in hits], np.float64)

    def samples(self, count: int = SAMPLES, seed: int = 0) -> np.ndarray:
        """Points (k, 3) metres on the surface: those of its corners, then `count` spread evenly over its area."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        corners = self.points[np.unique(self.triangles)]
        if not area.sum() > 0:
            return corners
        random = np.random.default_rng(seed)
        face = np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(count) + random.random(count)) / count)
        face = face.clip(0, len(area) - 1)
        u, v = random.random((2, count, 1))
        root = np.sqrt(u)
        return np.concatenate([corners, (1 - root) * a[face] + root * (1 - v) * b[face] + root * v * c[face]])


def has_area(corners: np.ndarray) -> np.ndarray:
    """Whether anything shows of triangles (m, 3, 3), (m,) bool."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1, initial=0)
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > FLAT * longest**2


def deviation(one: Surface, other: Surface, count: int = SAMPLES) -> tuple[float, float]:
    """(symmetric Hausdorff distance, root mean square), metres, between two surfaces, at the samples of both.

    The true Hausdorff distance is at least this; it lies between samples by at most their spacing. Source: Aspert,
    Santa-Cruz, Ebrahimi, "MESH: measuring errors between surfaces using the Hausdorff distance", 2002.
    """
    there, back = (a.nearest(b.samples(count))[2] for a, b in ((other, one), (one, other)))
    # corners are no even sample of the area
    rms = max(float(np.sqrt(np.mean(d[-count:] ** 2))) for d in (there, back))
    return float(max(there.max(), back.max())), rms
