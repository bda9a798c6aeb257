"""Flips of a LOD's edges that bring its surface nearer to the source's.

The two triangles at an edge from a to b, whose third corners are c and d, become the two triangles
at an edge from c to d.
"""

from dataclasses import dataclass

import numpy as np

from .closest_point import distances, walk
from .fit_state import FitState
from .pose_deformation import Copies
from .triangle_mesh import TriangleMesh, edge_keys, length, normals, ranges, sides_of_two

# cosine between a triangle after a flip and the mean of both before: none turns away
LEAST_COSINE = 0.5
SMALLEST = 0.05  # area of a triangle after a flip, of both before together


@dataclass(frozen=True)
class Flips:
    """Flips of k edges.

    corners: (4, k) the vertices a, b, c and d. faces: (2, k) the triangle at c, and that at d.
    """

    corners: np.ndarray
    faces: np.ndarray

    def take(self, index: np.ndarray) -> "Flips":
        """The flips of that index: (j,) integers, or (k,) bool."""
        return Flips(self.corners[:, index], self.faces[:, index])

    def in_copies(self, copies: Copies) -> "Flips":
        """The same flips in all copies of the mesh."""
        return Flips(copies.every(self.corners), copies.every(self.faces))


def find_flips(points: np.ndarray, corners: np.ndarray, seams: np.ndarray) -> Flips:
    """All flips that leave a sound mesh.

    The edge has two triangles and is no seam, the new one is no edge yet, and both triangles go on
    facing the same way with some area.

    points: (3, n); corners: (3, m); seams: (2, s).
    """
    n = points.shape[1]
    m = corners.shape[1]
    side, other_side, edges = sides_of_two(corners, n)
    a, b, c = (corners[(side // m + k) % 3, side % m] for k in (1, 2, 0))
    d = corners[other_side // m, other_side % m]
    sound = ~np.isin(edge_keys(np.stack([c, d]), n), edges)
    sound &= ~np.isin(edge_keys(np.stack([a, b]), n), edge_keys(seams, n))
    pa, pb, pc, pd = (points.take(corner, 1) for corner in (a, b, c, d))
    mean = normals(pc, pa, pb) + normals(pd, pb, pa)
    for normal in (normals(pc, pa, pd), normals(pd, pb, pc)):
        along = np.einsum("dn,dn->n", normal, mean)
        sound &= along > LEAST_COSINE * length(normal) * length(mean)
        sound &= length(normal) > SMALLEST * length(mean)
    return Flips(np.stack((a, b, c, d)), np.stack((side % m, other_side % m))).take(sound)


def measure_flips(
    state: FitState, source: TriangleMesh, flips: Flips, enough: np.ndarray
) -> np.ndarray:
    """The worst distance (k,) that each flip would lead to nearby, if it were the only one.

    source: the source's surface; flips: in all copies, as the state is. enough: (k,), where the
    distance reaches this, no more of it is measured.
    """
    points = state.lod.points
    a, b, c, d = flips.corners
    order = np.argsort(state.face, kind="stable")
    first = np.searchsorted(state.face[order], np.arange(state.lod.corners.shape[1] + 1))
    worst = np.zeros(len(a))
    for face in flips.faces:
        count = first[face + 1] - first[face]
        flip = np.repeat(np.arange(len(a)), count)
        samples = state.points.take(order[ranges(first[face], count)], 1)
        to_both = (
            distances(samples, *(points.take(corner[flip], 1) for corner in triangle))
            for triangle in ((c, a, d), (d, b, c))
        )
        np.maximum.at(worst, flip, np.minimum(*to_both))
    pa, pb, pc, pd = (points.take(corner, 1) for corner in (a, b, c, d))
    at_c, at_d = flips.faces
    # the middles of the new edge and of both new triangles
    for face, middle in (
        (at_c, (pc + pd) / 2),
        (at_c, (pc + pa + pd) / 3),
        (at_d, (pc + pb + pd) / 3),
    ):
        open_flips = np.flatnonzero(worst < enough)
        near = face[open_flips]
        start = source.corner(state.source_face[near], state.source_weights.take(near, 1))
        middle = middle.take(open_flips, 1)
        away = length(middle - source.at(*walk(source, start, middle)))
        worst[open_flips] = np.maximum(worst[open_flips], away)
    return worst


def choose_flips(flips: Flips, change: np.ndarray) -> Flips:
    """The flips of the least `change` (k,), of which no two share a triangle or make one edge."""
    flipped_faces: set[int] = set()
    new_edges = set()
    indices = []
    for k in np.argsort(change, kind="stable").tolist():
        faces = flips.faces[:, k].tolist()
        edge = frozenset(flips.corners[2:, k].tolist())
        if flipped_faces.isdisjoint(faces) and edge not in new_edges:
            flipped_faces.update(faces)
            new_edges.add(edge)
            indices.append(k)
    return flips.take(np.array(indices, np.intp))


def flip_edges(lod: TriangleMesh, flips: Flips) -> TriangleMesh:
    """The LOD with these edges flipped; flips: in all copies."""
    a, b, c, d = flips.corners
    at_c, at_d = flips.faces
    corners = lod.corners.copy()
    corners[:, at_c] = (c, a, d)
    corners[:, at_d] = (d, b, c)
    return TriangleMesh(lod.points, corners)
