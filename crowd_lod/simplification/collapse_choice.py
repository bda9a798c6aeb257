"""Which edges of a mesh collapse: where to, what that costs, and which may together.

Quadrics tell where to and the cost; no collapse may fold, open or pinch the mesh. Sources:
Garland, Heckbert, "Surface simplification using quadric error metrics", 1997; Dey, Edelsbrunner,
Guha, Nekhayev, "Topology preserving edge contraction", 1999, has the link condition.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .closest_point import BLOCK
from .pose_deformation import Skin
from .triangle_mesh import blocks, edge_keys, half_edges, length
from .triangle_mesh import normals as normals_of_faces

# A collapse's error is divided by its area to this power: 0 spares large faces, 1 treats all alike.
AREA_POWER = 0.9
# weight of an edge's middle against the planes: decides where they leave a choice
MIDPOINT = 1e-9
# No collapse makes a triangle thinner than this: twice its area over the sum of squared sides.
THINNEST = 0.001


@dataclass(frozen=True)
class Poses:
    """What the poses add to the mesh at rest.

    skin: how it moves; quadrics: those of the vertices, (11, n), in each pose.
    """

    skin: Skin
    quadrics: list[np.ndarray]


@dataclass(frozen=True)
class Edges:
    """Edges that may collapse.

    ends: (2, k) vertices; faces: (k,) how many have the edge; at: (3, k), where it would collapse
    to.
    """

    ends: np.ndarray
    faces: np.ndarray
    at: np.ndarray

    def take(self, edges: np.ndarray | slice) -> "Edges":
        return Edges(self.ends[:, edges], self.faces[edges], self.at[:, edges])


def quadrics_of(
    points: np.ndarray,
    triangles: np.ndarray,
    constrained: tuple[np.ndarray, np.ndarray],
    seam_weight: float = 1.0,
) -> np.ndarray:
    """Each vertex's quadric (11, n): xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, area.

    It sums the planes of the faces at the vertex, by their areas, and the planes upright on its
    constrained edges, by their lengths squared. points: (n, 3); triangles: (m, 3); constrained: see
    constrained_edges(); seam_weight: of seams, as part of that of borders.
    """
    n = len(points)
    sides, is_border = constrained
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal, area = _unit(np.cross(b - a, c - a))
    total = _spread(_planes(normal, a, area / 2), triangles.T, n)
    start, end = half_edges(triangles)[sides].T
    upright, length = _unit(np.cross(points[end] - points[start], normal[sides // 3]))
    weight = np.where(is_border, 1, seam_weight) * length**2
    total[:10] += _spread(_planes(upright, points[start], weight)[:10], (start, end), n)
    return total


def normals_of(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The sum (n, 3) of the normals of each point's triangles, by their areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return _spread(np.cross(b - a, c - a).T, triangles.T, len(points)).T


def _unit(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (k, 3) of length 1, and how long they were (k,)."""
    length = np.sqrt(np.einsum("nd,nd->n", vectors, vectors))
    return vectors / np.where(length > 0, length, 1)[:, None], length


def _planes(normal: np.ndarray, on: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Quadrics (11, k) of the squared distance to planes.

    normal: (k, 3); on: (k, 3), a point on each; weight: (k,).
    """
    x, y, z = normal.T
    d = -np.einsum("nd,nd->n", normal, on)
    return (
        np.stack(
            [x * x, x * y, x * z, y * y, y * z, z * z, x * d, y * d, z * d, d * d, np.ones(len(d))]
        )
        * weight
    )


def _spread(rows: np.ndarray, corners: Iterable[np.ndarray], n: int) -> np.ndarray:
    """Each row (k,) of `rows` summed over n vertices, those that `corners` (k,) name."""
    return np.stack([sum(np.bincount(corner, row, n) for corner in corners) for row in rows])


def place_collapses(
    points: np.ndarray, quadrics: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where edges from a to b collapse to (3, k), and at what cost (k,)."""
    at = np.empty((3, len(a)))
    cost = np.empty(len(a))
    for block in blocks(len(a), BLOCK):
        at[:, block], cost[block] = _place_block(points, quadrics, a[block], b[block])
    return at, cost


def _place_block(
    points: np.ndarray, quadrics: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As place_collapses(), all at once."""
    p = points.take(a, 1)
    q = points.take(b, 1)
    xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, area = quadrics.take(a, 1) + quadrics.take(b, 1)
    x, y, z = middle = (p + q) / 2
    gx = xx * x + xy * y + xz * z + xd
    gy = xy * x + yy * y + yz * z + yd
    gz = xz * x + yz * y + zz * z + zd
    cost = (gx + xd) * x + (gy + yd) * y + (gz + zd) * z + dd
    to_middle = MIDPOINT * area + 1e-300
    xx = xx + to_middle
    yy = yy + to_middle
    zz = zz + to_middle
    cxx = yy * zz - yz * yz
    cxy = xz * yz - xy * zz
    cxz = xy * yz - xz * yy
    cyy = xx * zz - xz * xz
    cyz = xy * xz - xx * yz
    czz = xx * yy - xy * xy
    adjugate = np.stack(
        [
            cxx * gx + cxy * gy + cxz * gz,
            cxy * gx + cyy * gy + cyz * gz,
            cxz * gx + cyz * gy + czz * gz,
        ]
    )
    step = -adjugate / np.maximum(xx * cxx + xy * cxy + xz * cxz, 1e-300)
    edge = np.einsum("dn,dn->n", p - q, p - q)
    # planes that hardly differ meet anywhere
    step *= np.einsum("dn,dn->n", step, step) <= 4 * edge
    cost = np.maximum(cost + gx * step[0] + gy * step[1] + gz * step[2], 0) + MIDPOINT * edge * area
    return middle + step, cost / (area + 1e-300) ** AREA_POWER


@dataclass(frozen=True)
class PoseErrors:
    """The errors of collapses in all poses.

    follows: (n,) what each vertex moves with; area: (n,) that each stands for.
    """

    poses: Poses
    follows: np.ndarray
    area: np.ndarray

    def add(self, cost: np.ndarray, errors: np.ndarray, edges: Edges, most: int) -> None:
        """Add the errors in all poses to the `cost` (k,) of edges that may be cheapest.

        errors: (k,), from the round before, or NaN; new ones are written into it. most: how many of
        the cheapest edges are needed.
        """
        has_error = ~np.isnan(errors)
        cost[has_error] += errors[has_error]
        limit = np.partition(cost, most - 1)[most - 1]
        # with poses none gets cheaper: what costs more than the limit before stays out
        for _ in range(2):
            new = np.flatnonzero(~has_error & (cost <= limit) & (cost < np.inf))
            ends = edges.ends.take(new, 1)
            at = edges.at.take(new, 1)
            area = self.area.take(ends).sum(axis=0)
            errors[new] = self.of(ends, at) / (area + 1e-300) ** AREA_POWER
            cost[new] += errors[new]
            has_error[new] = True
            limit = np.partition(np.where(has_error, cost, np.inf), most - 1)[most - 1]

    def of(self, ends: np.ndarray, at: np.ndarray) -> np.ndarray:
        """The error in all poses (k,) of collapses of the edges (2, k) to `at` (3, k)."""
        skin = self.poses.skin
        error = np.zeros(ends.shape[1])
        follow = skin.nearer(at, *self.follows[ends])
        for block in blocks(len(follow), BLOCK):
            a, b = ends[:, block]
            for j, quadrics in enumerate(self.poses.quadrics):
                xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, _ = quadrics.take(a, 1) + quadrics.take(
                    b, 1
                )
                x, y, z = skin.at(j, at[:, block], follow[block])
                gx = xx * x + xy * y + xz * z + xd
                gy = xy * x + yy * y + yz * z + yd
                gz = xz * x + yz * y + zz * z + zd
                error[block] += np.maximum((gx + xd) * x + (gy + yd) * y + (gz + zd) * z + dd, 0)
        return error


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
        candidates = _without_common_faces(order.ends, free, corners, n)
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


def _without_common_faces(
    ends: np.ndarray, free: np.ndarray, corners: np.ndarray, n: int
) -> np.ndarray:
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
