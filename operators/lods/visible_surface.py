"""The visible surface of a character or a LOD: what some direction sees in some pose."""

from collections.abc import Sequence

import numpy as np
from mathutils.bvhtree import BVHTree

from ...crowd_lod.simplification.triangle_mesh import ranges

DIRECTIONS = 50
# directions nearest to its normal that every point tries: in the first pose, and in each other one
FIRST = 4
FURTHER = 1
ONE_IN = 8  # of so many hidden points, far from seen ones, one tries all directions
OFF = 2e-4  # part of the size: how far off the surface a ray begins
SPACING = 1 / 32  # part of the size: triangles with longer sides have points within


def visible_points(points: np.ndarray, triangles: np.ndarray, hiding: np.ndarray) -> np.ndarray:
    """Return which points someone may see, (n,) bool: the corners of triangles that are seen.

    A triangle is seen if a ray from one of its points leaves the character, in one of DIRECTIONS
    in one of the poses. Callers count all triangles of these points: their neighbors
    are a margin for gaps that open between those poses.

    points: (n, k, 3) meters in k poses, those at the same place merged.
    triangles: (m, 3) indices.
    hiding: (m,) bool, the triangles that hide what is behind them.
    """
    if not hiding.any():
        return np.ones(len(points), bool)
    size = float(np.ptp(points[:, 0], axis=0).max())
    face, weights = _samples(points[:, 0], triangles, SPACING * size)
    rays = _Rays(points, triangles, hiding, OFF * size)
    corner = np.unique(triangles)
    vertices = np.arange(len(corner))
    is_seen = np.zeros(len(points), bool)
    tried = np.zeros(len(points), bool)

    is_seen[corner] = rays.leave(face[vertices], weights[vertices], rays.nearest)
    for ranks in (rays.nearest, rays.others):  # within triangles, until all their corners count
        inner = len(corner) + np.flatnonzero(~is_seen[triangles[face[len(corner) :]]].all(axis=1))
        large = face[inner[rays.leave(face[inner], weights[inner], ranks)]]
        is_seen[triangles[large]] = True
    # corners of what is set into a body are hidden, its middle is not
    inner = np.flatnonzero(~is_seen[triangles].any(axis=1))
    leaves = rays.leave(inner, np.full((len(inner), 3), 1 / 3), rays.nearest)
    is_seen[triangles[inner[leaves]]] = True
    due = np.zeros(len(points), bool)
    due[corner[::ONE_IN]] = True
    while True:
        due[triangles[is_seen[triangles].any(axis=1)]] = True
        samples = np.flatnonzero(due[corner] & ~is_seen[corner] & ~tried[corner])
        if not len(samples):
            return is_seen
        tried[corner[samples]] = True
        is_seen[corner[samples]] = rays.leave(face[samples], weights[samples], rays.others)


def visible_faces(
    points: np.ndarray, triangles: np.ndarray, hiding: np.ndarray, candidates: np.ndarray
) -> np.ndarray:
    """Return which of the triangles `candidates` (k,) someone may see, (k,) bool.

    points, triangles, hiding: see visible_points.
    """
    if not hiding.any():
        return np.ones(len(candidates), bool)
    size = float(np.ptp(points[:, 0], axis=0).max())
    face, weights = _samples(points[:, 0], triangles[candidates], SPACING * size)
    middles = np.arange(len(candidates)), np.full((len(candidates), 3), 1 / 3)
    face = np.concatenate([face, middles[0]])
    weights = np.concatenate([weights, middles[1]])
    rays = _Rays(points, triangles, hiding, OFF * size)
    is_seen = np.zeros(len(points), bool)
    for ranks in (rays.nearest, rays.others):
        hidden = ~is_seen[triangles[candidates[face]]].any(axis=1)
        face = face[hidden]
        weights = weights[hidden]
        leaves = rays.leave(candidates[face], weights, ranks)
        is_seen[triangles[candidates[face[leaves]]]] = True
    return is_seen[triangles[candidates]].any(axis=1)


class _Rays:
    """Rays from a surface in some poses, which may meet what hides.

    off: meters from the surface where they begin.
    nearest, others: the directions that points try in each pose, by their ranks, 0 for that nearest
    to the normal. Every point tries the nearest. The first pose has all others, the other poses
    share those before the surface.
    """

    def __init__(self, points: np.ndarray, triangles: np.ndarray, hiding: np.ndarray, off: float):
        self.triangles = triangles
        self.off = off
        middles = (points.min(axis=0) + points.max(axis=0)) / 2  # trees have float32 alone
        self.at = list((points - middles).transpose(1, 0, 2))
        faces = triangles[hiding].tolist()
        self.trees = [BVHTree.FromPolygons(at.tolist(), faces) for at in self.at]
        further = len(self.at) - 1
        shared = [range(FURTHER + k, DIRECTIONS // 2, further) for k in range(further)]
        self.nearest = [range(FIRST), *[range(FURTHER)] * further]
        self.others = [range(FIRST, DIRECTIONS), *shared]

    def leave(
        self, face: np.ndarray, weights: np.ndarray, ranks: Sequence[Sequence[int]]
    ) -> np.ndarray:
        """Return from which points some ray leaves, (s,) bool.

        face: (s,) triangles; weights: (s, 3), barycentric, on these; ranks: the directions to try
        in each pose.
        """
        is_seen = np.zeros(len(face), bool)
        for at, tree, tried in zip(self.at, self.trees, ranks, strict=True):
            samples = np.flatnonzero(~is_seen)
            corners = at[self.triangles[face[samples]]]
            start = np.einsum("sc,scd->sd", weights[samples], corners)
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            order = np.argsort(-normals @ SPHERE.T, axis=1)
            for rank in tried:
                ways = SPHERE[order[:, rank]]
                begins = start + self.off * ways
                hits = map(tree.ray_cast, begins.tolist(), ways.tolist())
                leaves = np.array([hit[0] is None for hit in hits], bool)
                is_seen[samples[leaves]] = True
                samples, start, order = (each[~leaves] for each in (samples, start, order))
        return is_seen


def _samples(
    points: np.ndarray, triangles: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return points of a surface, as (face (s,), barycentric weights (s, 3)).

    These are all corners, each on one of its triangles, and a grid within triangles whose sides
    are longer than `spacing`.
    """
    _, first = np.unique(triangles.ravel(), return_index=True)
    sides = points[triangles] - points[np.roll(triangles, -1, axis=1)]
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.max(axis=1)
    height = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / longest
    along, up = (np.ceil(each / spacing).astype(np.intp) for each in (longest, height))
    cells = np.where(along > 1, along * up.clip(1), 0)
    face = np.repeat(np.arange(len(triangles)), cells)
    row, column = np.divmod(ranges(np.zeros_like(cells), cells), along[face])
    x = (column + 0.5) / along[face]
    y = (row + 0.5) / up[face].clip(1)
    outside = x + y > 1
    x = np.where(outside, 1 - x, x)
    y = np.where(outside, 1 - y, y)
    order = (lengths.argmax(axis=1)[face, None] + np.arange(3)) % 3
    inner = np.empty((len(face), 3))
    np.put_along_axis(inner, order, np.stack([1 - x - y, x, y], axis=1), axis=1)
    return np.concatenate([first // 3, face]), np.concatenate([np.eye(3)[first % 3], inner])


def _sphere(count: int) -> np.ndarray:
    """Return (count, 3) directions spread evenly, on a spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * (np.arange(count) + 0.5)
    return (
        np.stack([np.cos(turn), np.sin(turn), 0 * z], axis=1) * np.sqrt(1 - z**2)[:, None]
        + [0, 0, 1] * z[:, None]
    )


SPHERE = _sphere(DIRECTIONS)
