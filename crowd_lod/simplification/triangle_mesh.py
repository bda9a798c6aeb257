"""Triangle meshes as columns: their topology, and vectors along them.

Arrays are (3, n), not (n, 3): NumPy is several times faster along the long axis.
"""

from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np

SIZES = (0.5, 0.9, 0.99, 1.0)  # parts of the faces, by size, that are searched apart


class FaceSpheres(NamedTuple):
    """Spheres about faces (k,): centers (3, k) and radii (k,)."""

    faces: np.ndarray
    middle: np.ndarray
    radius: np.ndarray


class TriangleMesh:
    """A triangle mesh, and which faces meet at its vertices and edges.

    points: (3, n) float64; corners: (3, m) vertices of the faces. Nobody writes to its arrays.
    vertex_faces: (3 m,) the faces at each vertex, one vertex after another; first: (n + 1,) where
    those of each begin.
    """

    def __init__(self, points: np.ndarray, corners: np.ndarray):
        self.points = points
        self.corners = corners
        self.vertex_faces = np.argsort(corners.ravel(), kind="stable") % corners.shape[1]
        self.first = np.concatenate(
            [[0], np.cumsum(np.bincount(corners.ravel(), minlength=points.shape[1]))]
        )

    def moved(self, points: np.ndarray) -> "TriangleMesh":
        """The same mesh with its vertices at `points` (3, n)."""
        mesh = copy(self)
        mesh.points = points
        mesh.__dict__.pop("spheres", None)
        return mesh

    def at(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The points (3, k) at barycentric weights (3, k) of the faces (k,)."""
        return sum(
            self.points.take(c, 1) * w
            for c, w in zip(self.corners.take(face, 1), weights, strict=True)
        )

    def vertices(self, face: np.ndarray) -> list[np.ndarray]:
        """Where the three vertices of each of the faces (k,) lie, three times (3, k)."""
        return [self.points.take(c, 1) for c in self.corners.take(face, 1)]

    def corner(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The vertex (k,) of each face (k,) with the largest of its weights (3, k)."""
        return self.corners[weights.argmax(axis=0), face]

    def faces_at(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The faces at each of the vertices (k,), one vertex after another.

        Returns the faces, and how many each vertex has (k,).
        """
        begin = self.first[vertices]
        count = self.first[vertices + 1] - begin
        return self.vertex_faces[ranges(begin, count)], count

    @cached_property
    def spheres(self) -> tuple[int, list[FaceSpheres]]:
        """The mesh's longest axis, and spheres about the faces, in order along that.

        They come in groups of like size, so that a few large faces do not widen all searches.
        """
        corner = [self.points.take(c, 1) for c in self.corners]
        middle = sum(corner) / 3
        radius = np.max([length(each - middle) for each in corner], axis=0)
        along = int(np.ptp(middle, axis=1).argmax())
        order = np.argsort(middle[along])
        size = np.digitize(radius[order], np.quantile(radius, SIZES)[:-1])
        groups = [order[size == k] for k in range(len(SIZES))]
        return along, [
            FaceSpheres(some, middle.take(some, 1), radius[some]) for some in groups if len(some)
        ]

    @cached_property
    def neighbors(self) -> np.ndarray:
        """The face (m, 3) across each face's edge from corner i to the next.

        -1 where there is none or several, and where the other has the edge in the same direction.
        """
        sides = np.stack([self.corners.T, self.corners.T[:, [1, 2, 0]]]).reshape(2, -1)
        n = self.points.shape[1]
        back = sides[1] * n + sides[0]
        forth = sides[0] * n + sides[1]
        keys, first, count = np.unique(forth, return_index=True, return_counts=True)
        place = np.searchsorted(keys, back).clip(max=len(keys) - 1)
        is_single = (
            (keys[place] == back) & (count[place] == 1) & (count[np.searchsorted(keys, forth)] == 1)
        )
        return np.where(is_single, first[place] // 3, -1).reshape(-1, 3)


def half_edges(triangles: np.ndarray) -> np.ndarray:
    """The edges (3 m, 2) of each of the triangles (m, 3), in the direction that it has them.

    Edge 3 t + i is that of triangle t from its corner i to the next.
    """
    return triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def constrained_edges(
    triangles: np.ndarray, seams: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """The half edges that are open borders or seams.

    triangles: (m, 3), of n vertices; seams: (k, 2). Returns their indices in half_edges() (h,), and
    which of them are borders (h,) bool.
    """
    keys = edge_keys(half_edges(triangles).T, n)
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    border = count[inverse] != 2
    held = np.flatnonzero(border | np.isin(keys, edge_keys(seams.T, n)))
    return held, border[held]


def edge_keys(ends: np.ndarray, n: int) -> np.ndarray:
    """One number (k,) for each edge (2, k) between n points, whichever way it runs."""
    return np.minimum(*ends) * n + np.maximum(*ends)


def edges_of(corners: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges of triangles, each once.

    corners: (3, m), of n vertices. Returns keys (k,) as in edge_keys(), ends (2, k), and how many
    triangles have each (k,).
    """
    keys = np.sort(edge_keys(np.stack([corners, np.roll(corners, 1, axis=0)]).reshape(2, -1), n))
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    faces = np.diff(first, append=len(keys))
    keys = keys[first]
    return keys, np.stack(np.divmod(keys, n)), faces


def sides_of_two(corners: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges between two triangles, as seen from each.

    Side i m + t is that of triangle t opposite its corner i. corners: (3, m), of n vertices.
    Returns the sides (k,) of the one triangle, those of the other (k,), and the keys of all sides
    (3 m,).
    """
    keys = edge_keys(
        np.stack([np.roll(corners, -1, axis=0).ravel(), np.roll(corners, -2, axis=0).ravel()]), n
    )
    order = np.argsort(keys, kind="stable")
    _, first, count = np.unique(keys[order], return_index=True, return_counts=True)
    double = first[count == 2]
    return order[double], order[double + 1], keys


def blocks(count: int, size: int) -> list[slice]:
    """Slices of `size` that make up range(count).

    NumPy is some three times faster on arrays that fit in the processor's cache.
    """
    return [slice(k, k + size) for k in range(0, count, size)]


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """first[0], first[0] + 1, ... count[0] of them, then those from first[1]."""
    return np.arange(count.sum()) + np.repeat(first - np.cumsum(count) + count, count)


def length(vectors: np.ndarray) -> np.ndarray:
    """Of vectors (3, k)."""
    return np.sqrt(np.einsum("dn,dn->n", vectors, vectors))


def normals(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Of triangles abc, each (3, k), as long as twice their area."""
    (ux, uy, uz) = b - a
    (vx, vy, vz) = c - a
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
