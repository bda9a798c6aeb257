"""Which edges of a mesh may collapse together, without folding, opening or pinching it.

Source: Dey, Edelsbrunner, Guha, Nekhayev, "Topology preserving edge contraction", 1999, has the
link condition.
"""

from dataclasses import dataclass

import numpy as np

from .quadrics import Edges
from .triangle_mesh import edge_keys, length
from .triangle_mesh import normals as normals_of_faces

# No collapse makes a triangle thinner than this: twice its area over the sum of squared sides.
THINNEST = 0.001


@dataclass(frozen=True)
class CollapsingMesh:
    """A mesh as far as it has collapsed.

    points: (3, n); corners: (3, m); normals: (3, n), the sums of those of the source's vertices
    that each stands for.
    """

    points: np.ndarray
    corners: np.ndarray
    normals: np.ndarray


def are_bridges(edges: np.ndarray, faces: np.ndarray, n: int) -> np.ndarray:
    """Which edges would join two borders if they collapsed, (k,) bool.

    edges: (2, k), of n vertices; faces: (k,) how many have each.
    """
    border = np.zeros(n, bool)
    border[edges[:, faces != 2]] = True
    return (faces == 2) & border[edges[0]] & border[edges[1]]


def are_flat(corners: np.ndarray) -> np.ndarray:
    """Which triangles (3, m) have a corner twice, (m,) bool."""
    a, b, c = corners
    return (a == b) | (b == c) | (c == a)


def choose_collapses(
    mesh: CollapsingMesh, edges: np.ndarray, order: Edges, passes: int, facing: float
) -> tuple[np.ndarray, np.ndarray]:
    """(which of `order` to collapse together, which must not collapse), as indices.

    edges: (2, j) all the mesh's edges; order: those that may collapse, the cheapest first; facing:
    see _valid().
    """
    n = mesh.points.shape[1]
    near = np.zeros(n, bool)
    near[order.ends] = True
    corners = mesh.corners.compress(near[mesh.corners].any(axis=0), axis=1)
    edges = edges.compress(near[edges].any(axis=0), axis=1)
    mesh = CollapsingMesh(mesh.points, corners, mesh.normals)
    free = np.ones(len(order.faces), bool)
    good = np.zeros(0, np.intp)
    bad = np.zeros(0, np.intp)
    for _ in range(passes):
        candidates = _apart(order.ends, free, corners, n)
        if not len(candidates):
            break
        free[candidates] = False
        valid = _valid(mesh, edges, order.take(candidates), facing)
        bad = np.append(bad, candidates[~valid])
        candidates = candidates[valid]
        good = np.append(good, candidates)
        free &= ~in_ring(corners, order.ends[:, candidates], n)[order.ends].any(axis=0)
    return np.sort(good), bad


def in_ring(corners: np.ndarray, ends: np.ndarray, n: int) -> np.ndarray:
    """Whether each of n points is in a triangle with one of `ends`, (n,) bool."""
    is_end = np.zeros(n, bool)
    is_end[ends] = True
    ring = is_end.copy()
    ring[corners[:, is_end[corners].any(axis=0)]] = True
    return ring


def _apart(ends: np.ndarray, free: np.ndarray, corners: np.ndarray, n: int) -> np.ndarray:
    """The free edges that share no face at their ends with a cheaper free edge.

    ends: (2, k) vertices, the cheapest edge first; free: (k,) bool; corners: (3, m), of n vertices.
    Returns indices: all of these may collapse at once.
    """
    edge = np.flatnonzero(free)
    cheapest, reach = np.full((2, n), len(free))
    for end in ends[:, edge]:
        np.minimum.at(cheapest, end, edge)
    vertex_faces = cheapest[corners].min(axis=0)
    for corner in corners:
        np.minimum.at(reach, corner, vertex_faces)
    return edge[(reach[ends[:, edge]] == edge).all(axis=0)]


def _valid(mesh: CollapsingMesh, edges: np.ndarray, candidates: Edges, facing: float) -> np.ndarray:
    """Whether each of the edges `candidates`, which lie apart, may collapse, (k,) bool.

    edges: (2, j) all of the mesh; facing: the least cosine between a face's normals before and
    after.
    """
    n = mesh.points.shape[1]
    candidate = np.full(n, -1)  # of which each point is an end
    candidate[candidates.ends] = np.arange(len(candidates.faces))
    good = _meets_link_condition(candidate, edges, candidates.faces)
    # the triangles that stay, with the edge's ends moved
    moved = candidate[mesh.corners]
    stays = (moved >= 0).sum(axis=0) == 1
    moved = moved[:, stays]
    corners = mesh.corners[:, stays]
    edge = moved.max(axis=0)
    good &= np.bincount(edge, minlength=len(good)) > 0
    # a tetrahedron would become two triangles back to back
    across = np.where(moved >= 0, -1, corners)
    high = across.max(axis=0)
    across = edge_keys(np.stack([across.sum(axis=0) + 1 - high, high]), n)
    good[_twice(edge * n * n + across) // n // n] = False
    good[edge[_spoils_faces(mesh, corners, moved, candidates, facing)]] = False
    return good


def _meets_link_condition(
    candidate: np.ndarray, edges: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Whether only the corners opposite of each edge are neighbors of both its ends, (k,) bool.

    candidate: (n,) which of the k edges each point is an end of, or -1; edges: (2, j) all of the
    mesh; faces: (k,) how many have each of the k edges.
    """
    n = len(candidate)
    candidate = candidate[edges]
    rim = (candidate >= 0).sum(axis=0) == 1
    neighbor = np.where(candidate[0] >= 0, edges[1], edges[0])
    common = _twice(candidate.max(axis=0)[rim] * n + neighbor[rim]) // n
    return np.bincount(common, minlength=len(faces)) == faces


def _spoils_faces(
    mesh: CollapsingMesh,
    corners: np.ndarray,
    moved: np.ndarray,
    candidates: Edges,
    facing: float,
) -> np.ndarray:
    """Whether triangles become thin, or turn, once a corner of each has moved, (m,) bool.

    corners: (3, m); moved: (3, m), by which of the `candidates` each corner is moved, or -1;
    facing: see _valid().
    """
    edge = moved.max(axis=0)
    at = candidates.at.take(edge, 1)
    old = [mesh.points.take(corner, 1) for corner in corners]
    new = [np.where(by >= 0, at, corner) for by, corner in zip(moved, old, strict=True)]
    was = normals_of_faces(*old)
    now = normals_of_faces(*new)
    was_size = length(was)
    size = length(now)
    was_long, long = (
        sum(np.einsum("dn,dn->n", side, side) for side in (a - b, b - c, c - a))
        for a, b, c in (old, new)
    )
    thin = (size < THINNEST * long) & (size * was_long <= was_size * long)
    merged = mesh.normals[:, candidates.ends].sum(axis=1).take(edge, 1)
    outward = [
        np.where(by >= 0, merged, mesh.normals.take(corner, 1))
        for by, corner in zip(moved, corners, strict=True)
    ]
    stands_for = np.sum([normal / (length(normal) + 1e-300) for normal in outward], axis=0)
    turned = (np.einsum("dn,dn->n", was, now) / (was_size * size + 1e-300) < facing) & (
        was_size > 0
    )
    turned |= np.einsum("dn,dn->n", stands_for, now) / (length(stands_for) * size + 1e-300) < facing
    return thin | turned


def _twice(keys: np.ndarray) -> np.ndarray:
    """Those of `keys` (k,) that come more than once."""
    keys = np.sort(keys)
    return keys[1:][keys[1:] == keys[:-1]]
