"""Quadric edge collapse, in rounds.

Each round collapses, the cheapest first, edges so far apart that they share no face at their ends.
Sources: Garland, Heckbert, "Surface simplification using quadric error metrics", 1997; the link
condition is that of Dey, Edelsbrunner, Guha, Nekhayev, "Topology preserving edge contraction",
1999.
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from . import settings
from .closest_point import BLOCK
from .loose_parts import LooseParts
from .pose_deformation import Skin
from .triangle_mesh import Shape, blocks, edge_keys, edges_of, half_edges, length
from .triangle_mesh import normals as normals_at


@dataclass(frozen=True)
class Poses:
    """What the poses add to the mesh at rest.

    skin: how it moves; quadrics: those of the vertices, (11, n), in each pose.
    """

    skin: Skin
    quadrics: list[np.ndarray]


@dataclass(frozen=True)
class _Mesh:
    """A mesh as far as it has collapsed.

    points: (3, n); corners: (3, m); normals: (3, n), the sums of those of the source's vertices
    that each stands for.
    """

    points: np.ndarray
    corners: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class _Edges:
    """Edges that may collapse.

    ends: (2, k) vertices; faces: (k,) how many have the edge; at: (3, k), where it would collapse
    to.
    """

    ends: np.ndarray
    faces: np.ndarray
    at: np.ndarray

    def take(self, some: np.ndarray) -> "_Edges":
        return _Edges(self.ends[:, some], self.faces[some], self.at[:, some])


def quadrics_of(
    points: np.ndarray,
    triangles: np.ndarray,
    held: tuple[np.ndarray, np.ndarray],
    hold: float = 1.0,
) -> np.ndarray:
    """Each vertex's quadric (11, n): xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, area.

    It sums the planes of the faces at the vertex, by their areas, and the planes upright on its
    constrained edges, by their lengths squared. points: (n, 3); triangles: (m, 3); held: see
    constrained_edges(); hold: weight of seams, of that of borders.
    """
    n = len(points)
    (side, border) = held
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal, area = _unit(np.cross(b - a, c - a))
    total = _spread(_planes(normal, a, area / 2), triangles.T, n)
    start, end = half_edges(triangles)[side].T
    upright, length = _unit(np.cross(points[end] - points[start], normal[side // 3]))
    total[:10] += _spread(
        _planes(upright, points[start], np.where(border, 1, hold) * length**2)[:10], (start, end), n
    )
    return total


def normals_of(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The sum (n, 3) of the normals of each point's triangles, by their areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return _spread(np.cross(b - a, c - a).T, triangles.T, len(points)).T


class Collapsed(NamedTuple):
    """A mesh with fewer triangles than its source, of n points.

    points: (k, 3); triangles: (m, 3). collapse_map: (n,), the point that each of the source's
    collapsed into, or -1.
    follows: (k,), the source's point that each moves with.
    """

    points: np.ndarray
    triangles: np.ndarray
    collapse_map: np.ndarray
    follows: np.ndarray


def collapse(
    shape: Shape, quadrics: np.ndarray, normals: np.ndarray, target: int, poses: Poses | None = None
) -> Generator[None, None, Collapsed]:
    """Collapse edges until at most `target` faces are left, or as few as may be.

    shape: points (n, 3), about of unit size, and triangles (m, 3); quadrics: (11, n); normals: (n,
    3). With `poses` the errors in these add to that at rest. Source: Mohr, Gleicher, "Deformation
    sensitive decimation", 2003.

    Yields between the rounds. Returns the mesh with all n points, whose indices stay; of an edge's
    two it moves with the nearer. No collapse opens, closes, pinches or folds the surface; each part
    keeps a triangle, or four where it is closed. Loose parts become cards, or go, where that costs
    less than the next collapses (see LooseParts).
    """
    points, triangles = shape
    all_points, all_landed, all_follow = points.copy(), *np.tile(np.arange(len(points)), (2, 1))
    # of few of them, when most have collapsed before
    own, corners = np.unique(triangles, return_inverse=True)
    # (3, m): NumPy is several times faster along the long axis
    corners = np.ascontiguousarray(corners.reshape(-1, 3).T)
    points = points.T.take(own, 1)
    quadrics = quadrics.take(own, 1)
    normals = normals.T.take(own, 1)
    n = len(own)
    poses = poses and Poses(poses.skin, [each.take(own, 1) for each in poses.quadrics])
    follows = own.copy()
    loose = LooseParts(
        [points.copy(), *(place[own].T for place in (poses.skin.place if poses else ()))],
        corners,
        quadrics[10],
    )
    collapse_map = np.arange(n)
    refused = np.zeros(0, np.intp)
    thorough = False
    facing = settings.CURRENT.facing
    keys = np.zeros(0, np.intp)
    known = np.zeros((5, 0))
    changed = np.zeros(n, bool)
    while corners.shape[1] > target:
        before = keys
        (keys, edges, faces) = edges_of(corners, n)
        # of each edge where it would collapse to, its cost at rest and, if known, its error in the
        # poses: most stay as they were
        known = _taken_over(before, known, keys, changed[edges].any(axis=0))
        new = np.flatnonzero(np.isnan(known[3]))
        known[:3, new], known[3, new] = _place(points, quadrics, *edges.take(new, 1))
        found = _Edges(edges, faces, known[:3])
        barred = _bridges(edges, faces, n) | np.isin(keys, refused)
        barred |= loose.is_card[loose.part[edges[0]]]
        cost = np.where(barred, np.inf, known[3])
        most = (
            len(cost)
            if thorough
            else min(len(cost), max(64, int(settings.CURRENT.round_part * len(cost))))
        )
        if poses:
            errors = _PoseErrors(poses, follows, quadrics[10])
            errors.add(cost, known[4], found, most)
        order = _cheapest(cost, most)
        excess = corners.shape[1] - target
        dearest = cost[order[: excess // 2 + 1]].max(initial=0)
        if loose.cheapest <= dearest:
            corners = loose.give_up(corners, dearest, excess)
            continue
        passes = len(order) if thorough else settings.CURRENT.round_passes
        chosen, bad = (
            order[each]
            for each in _choose(
                _Mesh(points, corners, normals), edges, found.take(order), passes, facing
            )
        )
        refused = np.append(refused, keys[bad])
        if not len(chosen):
            if thorough and facing == settings.CURRENT.facing_last:
                if loose.cheapest == np.inf:
                    break
                corners = loose.give_up(corners, np.inf, excess)
                continue
            if thorough:
                refused = refused[:0]
                facing = settings.CURRENT.facing_last
            thorough = not thorough
            changed = np.zeros(n, bool)
            continue
        chosen = chosen[: np.searchsorted(np.cumsum(faces[chosen]), excess) + 1]
        if loose.cheapest < np.inf:
            true_cost = loose.true_costs(
                points, corners, edges[:, chosen], known[:3, chosen], quadrics[10]
            )
            if true_cost.min() > loose.cheapest:
                corners = loose.give_up(corners, true_cost.min(), excess)
                continue
            chosen = chosen[true_cost <= loose.cheapest]
            loose.follow(edges[:, chosen], known[:3, chosen])
        keep, gone = ends = edges[:, chosen]
        around = _ring(corners, ends, n)
        refused = refused[~around[np.stack(np.divmod(refused, n))].any(axis=0)]
        thorough = False
        points[:, keep] = found.at.take(chosen, 1)
        follows[keep] = (
            poses.skin.nearer(points[:, keep], *follows[ends]) if poses else follows[keep]
        )
        changed = np.zeros(n, bool)
        changed[keep] = True
        for each in (quadrics, normals, *(poses.quadrics if poses else ())):
            each[:, keep] += each[:, gone]
        collapse_map, corners = _merged(ends, collapse_map, corners)
        yield
    points, collapse_map, follows = loose.restore_cards(points, collapse_map, follows, own)
    all_points[own] = points.T
    all_landed[own] = own[collapse_map]
    all_follow[own] = follows
    return Collapsed(all_points, own[corners].T, all_landed, all_follow)


def _cheapest(cost: np.ndarray, most: int) -> np.ndarray:
    """The `most` edges of least finite `cost` (k,), the cheapest first.

    Those as cheap as the last of them are among them.
    """
    order = np.flatnonzero((cost <= np.partition(cost, most - 1)[most - 1]) & (cost < np.inf))
    return order[np.argsort(cost[order], kind="stable")]


def _merged(
    ends: np.ndarray, collapse_map: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(collapse_map (n,), corners (3, j)) once each edge's second end has become its first.

    ends: (2, k), of the edges.

    corners: (3, m); triangles that become flat are dropped.
    """
    move = np.arange(len(collapse_map))
    move[ends[1]] = ends[0]
    corners = move[corners]
    return move[collapse_map], corners.compress(~_flat(corners), axis=1)


def _taken_over(
    before: np.ndarray, known: np.ndarray, keys: np.ndarray, changed: np.ndarray
) -> np.ndarray:
    """What is known of edges from the round before.

    before: (j,) keys, in order; known: (r, j), of these; keys: (k,), in order; changed: (k,) bool.
    Returns (r, k): NaN for edges that are new or have changed.
    """
    found = np.full((len(known), len(keys)), np.nan)
    if len(before):
        at = np.minimum(np.searchsorted(before, keys), len(before) - 1)
        same = np.flatnonzero((before[at] == keys) & ~changed)
        found[:, same] = known.take(at[same], 1)
    return found


def _bridges(edges: np.ndarray, faces: np.ndarray, n: int) -> np.ndarray:
    """Which edges would join two borders if they collapsed, (k,) bool.

    edges: (2, k), of n vertices; faces: (k,) how many have each.
    """
    border = np.zeros(n, bool)
    border[edges[:, faces != 2]] = True
    return (faces == 2) & border[edges[0]] & border[edges[1]]


def _flat(corners: np.ndarray) -> np.ndarray:
    """Which triangles (3, m) have a corner twice, (m,) bool."""
    a, b, c = corners
    return (a == b) | (b == c) | (c == a)


def _choose(
    mesh: _Mesh, edges: np.ndarray, order: _Edges, passes: int, facing: float
) -> tuple[np.ndarray, np.ndarray]:
    """(which of `order` to collapse together, which must not collapse), as indices.

    edges: (2, j) all the mesh's edges; order: those that may collapse, the cheapest first; facing:
    see _valid().
    """
    n = mesh.points.shape[1]
    near = np.zeros(n, bool)
    near[order.ends] = True
    corners, edges = (
        each.compress(near[each].any(axis=0), axis=1) for each in (mesh.corners, edges)
    )
    mesh = _Mesh(mesh.points, corners, mesh.normals)
    free = np.ones(len(order.faces), bool)
    chosen = np.zeros(0, np.intp)
    bad = np.zeros(0, np.intp)
    for _ in range(passes):
        found = _apart(order.ends, free, corners, n)
        if not len(found):
            break
        free[found] = False
        good = _valid(mesh, edges, order.take(found), facing)
        bad = np.append(bad, found[~good])
        chosen = np.append(chosen, found[good])
        free &= ~_ring(corners, order.ends[:, found[good]], n)[order.ends].any(axis=0)
    return np.sort(chosen), bad


def _unit(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    length = np.sqrt(np.einsum("nd,nd->n", vectors, vectors))
    return vectors / np.where(length > 0, length, 1)[:, None], length


def _planes(normal: np.ndarray, on: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Quadrics (11, k) of the squared distance to planes.

    normal: (k, 3); on: (k, 3), a point on each; weight: (k,).
    """
    (x, y, z) = normal.T
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


def _place(
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
    """As _place(), all at once."""
    p = points.take(a, 1)
    q = points.take(b, 1)
    xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, area = quadrics.take(a, 1) + quadrics.take(b, 1)
    x, y, z = middle = (p + q) / 2
    gx = xx * x + xy * y + xz * z + xd
    gy = xy * x + yy * y + yz * z + yd
    gz = xz * x + yz * y + zz * z + zd
    cost = (gx + xd) * x + (gy + yd) * y + (gz + zd) * z + dd
    hold = settings.CURRENT.midpoint * area + 1e-300
    xx = xx + hold
    yy = yy + hold
    zz = zz + hold
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
    cost = (
        np.maximum(cost + gx * step[0] + gy * step[1] + gz * step[2], 0)
        + settings.CURRENT.midpoint * edge * area
    )
    return middle + step, cost / (area + 1e-300) ** settings.CURRENT.area_power


@dataclass(frozen=True)
class _PoseErrors:
    """The errors of collapses in all poses.

    follows: (n,) what each vertex moves with; area: (n,) that each stands for.
    """

    poses: Poses
    follows: np.ndarray
    area: np.ndarray

    def add(self, cost: np.ndarray, error: np.ndarray, edges: _Edges, most: int) -> None:
        """Add the errors in all poses to the `cost` (k,) of edges that may be cheapest.

        error: (k,), known from the round before, or NaN; it takes up what is new. most: how many of
        the cheapest are wanted.
        """
        known = ~np.isnan(error)
        cost[known] += error[known]
        limit = np.partition(cost, most - 1)[most - 1]
        # with poses none gets cheaper: what costs more than the limit before stays out
        for _ in range(2):
            some = np.flatnonzero(~known & (cost <= limit) & (cost < np.inf))
            ends = edges.ends.take(some, 1)
            at = edges.at.take(some, 1)
            area = self.area.take(ends).sum(axis=0)
            error[some] = self.of(ends, at) / (area + 1e-300) ** settings.CURRENT.area_power
            cost[some] += error[some]
            known[some] = True
            limit = np.partition(np.where(known, cost, np.inf), most - 1)[most - 1]

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


def _ring(corners: np.ndarray, ends: np.ndarray, n: int) -> np.ndarray:
    """Whether each of n points is in a triangle with one of `ends`, (n,) bool."""
    mine = np.zeros(n, bool)
    ring = np.zeros(n, bool)
    mine[ends] = ring[ends] = True
    a, b, c = mine[corners]
    ring[corners[:, a | b | c]] = True
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


def _valid(mesh: _Mesh, edges: np.ndarray, chosen: _Edges, facing: float) -> np.ndarray:
    """Whether each of the edges `chosen`, which lie apart, may collapse, (k,) bool.

    edges: (2, j) all of the mesh; facing: the least cosine between a face's normals before and
    after.
    """
    points = mesh.points
    corners = mesh.corners
    normals = mesh.normals
    ends = chosen.ends
    at = chosen.at
    faces = chosen.faces
    n = points.shape[1]
    k = ends.shape[1]
    which = np.full(n, -1)
    which[ends] = np.arange(k)
    # link condition: only the corners opposite of the edge are neighbors of both its ends
    mine = which[edges]
    rim = (mine >= 0).sum(axis=0) == 1
    other = np.where(mine[0] >= 0, edges[1], edges[0])
    good = np.bincount(_twice(mine.max(axis=0)[rim] * n + other[rim]) // n, minlength=k) == faces
    # the triangles that stay, with the edge's ends moved
    mine = which[corners]
    stays = (mine >= 0).sum(axis=0) == 1
    mine = mine[:, stays]
    rest = corners[:, stays]
    edge = mine.max(axis=0)
    good &= np.bincount(edge, minlength=k) > 0
    # a tetrahedron would become two triangles back to back
    across = np.where(mine >= 0, -1, rest)
    high = across.max(axis=0)
    across = edge_keys(np.stack([across.sum(axis=0) + 1 - high, high]), n)
    good[_twice(edge * n * n + across) // n // n] = False
    old = [points.take(corner, 1) for corner in rest]
    new = [
        np.where(moved >= 0, at.take(edge, 1), corner)
        for moved, corner in zip(mine, old, strict=True)
    ]
    was = normals_at(*old)
    now = normals_at(*new)
    was_size = length(was)
    size = length(now)
    was_long, long = (
        sum(np.einsum("dn,dn->n", side, side) for side in (a - b, b - c, c - a))
        for a, b, c in (old, new)
    )
    thin = (size < settings.CURRENT.thinnest * long) & (size * was_long <= was_size * long)
    merged = normals[:, ends].sum(axis=1)
    outward = [
        np.where(m >= 0, merged.take(edge, 1), normals.take(c, 1))
        for m, c in zip(mine, rest, strict=True)
    ]
    stands_for = sum(each / (length(each) + 1e-300) for each in outward)
    turned = (np.einsum("dn,dn->n", was, now) / (was_size * size + 1e-300) < facing) & (
        was_size > 0
    )
    turned |= np.einsum("dn,dn->n", stands_for, now) / (length(stands_for) * size + 1e-300) < facing
    good[edge[thin | turned]] = False
    return good


def _twice(keys: np.ndarray) -> np.ndarray:
    """Those of `keys` (k,) that come more than once."""
    keys = np.sort(keys)
    return keys[1:][keys[1:] == keys[:-1]]
