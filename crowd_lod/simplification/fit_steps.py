"""The steps of a fit: moves of a LOD's vertices and flips of its edges, and the state between them.

Moves are least squares over the samples, held on seams, never folded. A flip turns the two
triangles at an edge from a to b, whose third corners are c and d, into the two at an edge from c to
d.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .closest_point import distances, walk
from .pose_deformation import Copies
from .triangle_mesh import TriangleMesh, edge_keys, length, normals, ranges, sides_of_two

UNMEASURED: Any = None  # what SurfaceFit.measure is to fill
HALVINGS = 3  # times that a move which turns a triangle is halved before it is dropped
WEIGHT_KEPT = 0.8  # part of a sample's weight that it keeps for the next move
# Each move adds to a sample's weight its distance over the worst near it, to this power.
WEIGHT_POWER = 10.0
# That worst is a mean of the worst near it and the worst of all; this is the former's exponent.
WEIGHT_LOCAL = 0.8
NEGLIGIBLE = 1e-3  # pull of a sample that moves nothing
# of a triangle in one halving of a move: cosine to its normal before, and how much of its area
# along that must be left
LEAST_COSINE_MOVED = 0.8
LEAST_AREA_LEFT = 0.2
UNFOLDINGS = 20  # times that moves are taken back, at most
# cosine between a triangle after a flip and the mean of both before: none turns away
LEAST_COSINE = 0.5
SMALLEST = 0.05  # area of a triangle after a flip, of both before together


@dataclass(frozen=True)
class FitState:
    """A fit at one moment: a value, whose arrays are never written to.

    lod: the LOD, in all copies. worst: the largest distance of a sample from the other surface.

    k samples lie on the source. points: (3, k) their places; face (k,), weights (3, k): the closest
    points of the LOD; off: (3, k) from these to the samples, distance: (k,) its length; pull: (k,)
    their weights in the next move.

    j samples lie on the LOD. lod_face (j,), lod_weights (3, j): their places; source_face (j,),
    source_weights (3, j): the closest points of the source; lod_off: (3, j) from the samples to
    these, lod_distance: (j,) its length; lod_pull: (j,) as above.
    """

    lod: TriangleMesh
    points: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    pull: np.ndarray
    lod_face: np.ndarray
    lod_weights: np.ndarray
    source_face: np.ndarray
    source_weights: np.ndarray
    lod_pull: np.ndarray
    off: np.ndarray = UNMEASURED
    distance: np.ndarray = UNMEASURED
    lod_off: np.ndarray = UNMEASURED
    lod_distance: np.ndarray = UNMEASURED
    worst: float = np.inf

    def errors(self) -> np.ndarray:
        """The worst distance at each face of the LOD, (m,)."""
        errors = np.zeros(self.lod.corners.shape[1])
        np.maximum.at(errors, self.face, self.distance)
        np.maximum.at(errors, self.lod_face, self.lod_distance)
        return errors

    def errors_around(self) -> np.ndarray:
        """The worst distance at each face of the LOD and the faces that share a vertex, (m,)."""
        worst = np.zeros(self.lod.points.shape[1])
        errors = self.errors()
        for corner in self.lod.corners:
            np.maximum.at(worst, corner, errors)
        return worst[self.lod.corners].max(axis=0)


def weigh_samples(state: FitState) -> tuple[np.ndarray, np.ndarray]:
    """The weights for the next move: of the source's samples (k,), and of the LOD's (j,).

    Each sample weighs by how far off it was at this move and those before, compared with others
    near it: that leads to the least worst distance everywhere at once.
    Source: Lawson, "Contributions to the theory of linear least maximum approximation", 1961.
    """
    worst = state.errors_around() ** WEIGHT_LOCAL * state.worst ** (1 - WEIGHT_LOCAL)
    worst += 1e-300  # at rest there may be none
    return tuple(
        WEIGHT_KEPT * pull + (distance / worst[face]) ** WEIGHT_POWER
        for pull, distance, face in (
            (state.pull, state.distance, state.face),
            (state.lod_pull, state.lod_distance, state.lod_face),
        )
    )


def sum_pulls(
    state: FitState, pull: np.ndarray, lod_pull: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the samples pull at each vertex: weights (n,), and weighed offsets (3, n)."""
    n = state.lod.points.shape[1]
    total = np.zeros(n)
    move = np.zeros((3, n))
    for face, weights, pulls, off in (
        (state.face, state.weights, pull, state.off),
        (state.lod_face, state.lod_weights, lod_pull, state.lod_off),
    ):
        pulling = np.flatnonzero(pulls > NEGLIGIBLE)
        off = off.take(pulling, 1)
        corners = state.lod.corners.take(face[pulling], 1)
        parts = weights.take(pulling, 1) * pulls[pulling]
        for corner, part in zip(corners, parts, strict=True):
            total += np.bincount(corner, part, n)
            move += [np.bincount(corner, part * along, n) for along in off]
    return total, move


def hold_on_seams(
    points: np.ndarray, corners: np.ndarray, seams: np.ndarray, move: np.ndarray
) -> np.ndarray:
    """The `move` (3, n), in which vertices on seams move along their normal and the seam only.

    Or faces would reach across the seam.

    points: (3, n); corners: (3, m); seams: (2, s) edges.
    """
    a, b = seams
    seam_vertices, ends = np.unique(seams, return_inverse=True)
    if not len(seam_vertices):
        return move
    flat = normals(*(points.take(c, 1) for c in corners))
    normal = np.stack(
        [sum(np.bincount(c, x, points.shape[1]) for c in corners) for x in flat]
    ).take(seam_vertices, 1)
    normal /= length(normal) + 1e-300
    side = points.take(b, 1) - points.take(a, 1)
    side = np.tile(side / (length(side) + 1e-300), 2)
    slide = np.einsum("dn,dn->n", side, move.take(np.append(a, b), 1))
    ends = ends.ravel()
    along_seam = np.stack([np.bincount(ends, along * slide) for along in side])
    along_seam /= np.bincount(ends)
    along_normal = np.einsum("dn,dn->n", normal, move.take(seam_vertices, 1))
    move = move.copy()
    move[:, seam_vertices] = normal * along_normal + along_seam
    return move


def unfold(old: np.ndarray, new: np.ndarray, corners: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """The vertices `new`, moved back where a face would turn or become a sliver.

    Vertices of such faces go half as far, and in the end not at all.

    old, new: (3, n); corners: (3, m). facing: (3, m) where each face should look: one that looks
    that way with the vertices `old` goes on to do so.
    """
    was = normals(*(old.take(c, 1) for c in corners))
    size = np.einsum("dn,dn->n", was, was)
    upright = np.einsum("dn,dn->n", was, facing) > 0
    for k in range(UNFOLDINGS):
        now = normals(*(new.take(c, 1) for c in corners))
        along = np.einsum("dn,dn->n", was, now)
        bad = along < LEAST_COSINE_MOVED * np.sqrt(size) * length(now)
        bad |= along < LEAST_AREA_LEFT * size
        bad |= upright & (np.einsum("dn,dn->n", now, facing) < 0)
        stay = np.unique(corners[:, bad])
        stay = stay[(new[:, stay] != old[:, stay]).any(axis=0)]
        if not len(stay):
            return new
        if k < HALVINGS:
            new[:, stay] = (new[:, stay] + old[:, stay]) / 2
        else:
            new[:, stay] = old[:, stay]
    return old


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
