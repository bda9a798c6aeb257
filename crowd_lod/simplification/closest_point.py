"""Points on triangles: samples of surfaces, and closest points by walks over the faces."""

import numpy as np

from .triangle_mesh import TriangleMesh, blocks, edge_keys, length, ranges

WALK_STEPS = 40  # along a surface to the nearest triangle, at most
# Points that are off by this part of the largest distance search their nearest triangle again.
SEARCHED_AGAIN = 0.5
DOUBTED = 32  # points farthest off, whose walks may have ended at a wrong place
DOUBTS = 12  # searches for these, at most, while one of them was wrong

BLOCK = 16_000  # faces looked at together: what fits in the processor's cache
SIDE_PARTS = 60  # of a side: all samples of a lattice lie at whole ones


def walk(
    mesh: TriangleMesh, start: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The mesh's points closest to `points`, by walks from vertex to vertex.

    A walk goes from its vertex to the closest face at it, to the closest vertex of that face, and
    on until it comes back. It may end where it is closest only nearby: see doubt().

    start: (k,) vertices; points: (3, k). Returns faces (k,) and barycentric weights on them (3, k).
    """
    start = start.copy()
    face, weights = _closest_round(mesh, start, points)
    going = np.arange(len(start))
    for _ in range(WALK_STEPS):
        corner = mesh.corner(face[going], weights.take(going, 1))
        moved = corner != start[going]
        going = going[moved]
        corner = corner[moved]
        if not len(going):
            break
        start[going] = corner
        face[going], weights[:, going] = _closest_round(mesh, corner, points.take(going, 1))
    return face, weights


def follow(
    mesh: TriangleMesh,
    face: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    walking: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The closest points again, after the mesh or the points have moved a little.

    face: (k,), weights: (3, k), the closest points before; points: (3, k). Only points farther off
    than a part of the largest distance are brought up to date: on the same face, and if `walking`
    by a walk from its edge.
    Returns faces, weights, the offsets (3, k) from the closest points to `points`, and their
    lengths (k,).
    """
    off = points - mesh.at(face, weights)
    distance = length(off)
    far = np.flatnonzero(distance > SEARCHED_AGAIN * distance.max(initial=0))
    face = face.copy()
    weights = weights.copy()
    there = points.take(far, 1)
    at = closest_weights(there, *mesh.vertices(face[far]))
    weights[:, far] = at
    side = np.flatnonzero((at <= 0).any(axis=0) & walking)
    start = mesh.corner(face[far[side]], at.take(side, 1))
    face[far[side]], weights[:, far[side]] = walk(mesh, start, there.take(side, 1))
    off[:, far] = there - mesh.at(face[far], weights.take(far, 1))
    distance[far] = length(off.take(far, 1))
    return face, weights, off, distance


def doubt(
    mesh: TriangleMesh,
    face: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    count: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Search again, on all faces near enough, for the points that are farthest off.

    face: (k,), weights: (3, k), the closest points as known; points: (3, k); count: how many to
    doubt at a time. It goes on while any of them was wrong. Returns faces and weights.
    """
    face = face.copy()
    weights = weights.copy()
    count = count or DOUBTED
    distance = length(points - mesh.at(face, weights))
    for _ in range(DOUBTS if len(face) else 0):
        far = np.argpartition(-distance, min(count, len(distance)) - 1)[:count]
        far = far[distance[far] > distance[far].max() / 2]
        doubted = points.take(far, 1)
        most = distance[far] + 1e-6
        point, candidate = _faces_within(mesh, doubted, most)
        place = doubted.take(point, 1)
        at = closest_weights(place, *mesh.vertices(candidate))
        away = length(place - mesh.at(candidate, at))
        order = np.lexsort((away, point))
        point, first = np.unique(point[order], return_index=True)
        best = order[first]
        better = away[best] < 0.99 * distance[far[point]]
        if not better.any():
            break
        best = best[better]
        far = far[point[better]]
        face[far] = candidate[best]
        weights[:, far] = at.take(best, 1)
        distance[far] = away[best]
    return face, weights


def _faces_within(
    mesh: TriangleMesh, points: np.ndarray, most: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (point (j,), face (j,)) of all faces that may be nearest to points (3, k).

    most: (k,), none is farther off; lowered by what the faces' spheres tell.
    """
    along, groups = mesh.spheres
    parts = []
    for faces, middle, radius in groups:
        reach = most + radius.max()
        begin, end = (
            np.searchsorted(middle[along], points[along] + side) for side in (-reach, reach)
        )
        point = np.repeat(np.arange(len(most)), end - begin)
        candidate = ranges(begin, end - begin)
        away = length(points.take(point, 1) - middle.take(candidate, 1))
        np.minimum.at(most, point, away + radius[candidate] + 1e-6)
        parts.append((point, faces[candidate], away - radius[candidate]))
    point, face, least = (np.concatenate(part) for part in zip(*parts, strict=True))
    near = least < most[point]
    return point[near], face[near]


def beyond(
    mesh: TriangleMesh, least: float, face: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points are farther from the mesh than `least`, and their closest points.

    face: (k,) where the walks begin; points: (3, k). Returns the indices of those points (j,),
    faces (j,), weights (3, j).
    """
    far = np.flatnonzero(distances(points, *mesh.vertices(face)) > least)
    points = points.take(far, 1)
    corners = mesh.corners.take(face[far], 1)
    near = np.argmin([length(points - mesh.points.take(c, 1)) for c in corners], axis=0)
    face, weights = doubt(mesh, *walk(mesh, corners[near, np.arange(len(far))], points), points)
    still = np.flatnonzero(length(points - mesh.at(face, weights)) > least)
    return far[still], face[still], weights.take(still, 1)


def _closest_round(
    mesh: TriangleMesh, start: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As walk(), on the faces at the vertices `start` (k,) alone."""
    face = np.empty(len(start), np.intp)
    weights = np.empty((3, len(start)))
    for block in blocks(len(start), BLOCK // 8):
        around, count = mesh.faces_at(start[block])
        owner = np.repeat(np.arange(len(count)), count)
        block_points = points[:, block]
        square = squares(block_points.take(owner, 1), *mesh.vertices(around))
        hit = np.flatnonzero(
            square == np.repeat(np.minimum.reduceat(square, np.cumsum(count) - count), count)
        )
        face[block] = around[hit[np.searchsorted(owner[hit], np.arange(len(count)))]]
        weights[:, block] = _closest_weights(block_points, *mesh.vertices(face[block]))
    return face, weights


def barycentric(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric weights (3, k) of points p, dropped onto the planes of triangles.

    p, a, b, c: (3, k), the points and the triangles' corners. Triangles without area get thirds.
    """
    products = _products(p, a, b, c)
    uu, uv, vv = products[:3]
    s, t = _on_plane(products)
    flat = uu * vv - uv * uv <= 1e-12 * uu * vv
    s[flat] = t[flat] = 1 / 3
    return np.stack([1 - s - t, s, t])


def closest_weights(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric weights (3, k) of the points of triangles closest to points p.

    p, a, b, c: (3, k), the points and the triangles' corners.
    """
    weights = np.empty(p.shape)
    for block in blocks(p.shape[1], BLOCK):
        weights[:, block] = _closest_weights(*(each[:, block] for each in (p, a, b, c)))
    return weights


def distances(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Distances (k,) of p to the triangles abc, each (3, k)."""
    square = np.empty(p.shape[1])
    for block in blocks(p.shape[1], BLOCK):
        square[block] = squares(*(each[:, block] for each in (p, a, b, c)))
    return np.sqrt(square)


def _closest_weights(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """As closest_weights(), all at once."""
    _, s, t, (ab, ac, bc), (on_ab, on_ac, on_bc) = _planes_and_sides(p, a, b, c)
    # no where(): the processor cannot foresee which
    inside = np.minimum(np.minimum(s, t), 1 - s - t) >= 0
    is_ab = (on_ab <= on_ac) & (on_ab <= on_bc)
    is_bc = ~is_ab & (on_bc < on_ac) & ~inside
    is_ac = ~(is_ab | is_bc | inside)
    is_ab &= ~inside
    s = s * inside + ab * is_ab + (1 - bc) * is_bc
    t = t * inside + ac * is_ac + bc * is_bc
    return np.stack([1 - s - t, s, t])


def squares(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Squared distances (k,) of points p to triangles abc, each (3, k)."""
    (ww, plane), s, t, _, away = _planes_and_sides(p, a, b, c)
    sides = np.minimum(np.minimum(*away[:2]), away[2])
    inside = np.minimum(np.minimum(s, t), 1 - s - t) >= 0
    return np.maximum(ww + sides + inside * (plane - sides), 0)


def _products(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[np.ndarray]:
    """The dot products (k,) uu, uv, vv, wu, wv, ww.

    u = b - a, v = c - a, w = p - a.
    """
    u = b - a
    v = c - a
    w = p - a
    return [
        np.einsum("dn,dn->n", *pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v), (w, w))
    ]


def _on_plane(products: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights (k,) of b and of c: p dropped onto the triangle's plane."""
    uu, uv, vv, wu, wv, _ = products
    area = uu * vv - uv * uv + 1e-300
    return (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area


def _planes_and_sides(
    p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> tuple[tuple, np.ndarray, np.ndarray, tuple, tuple]:
    """What closest points of triangles are computed from, each (k,).

    Returns: the squared distance to a and what to add for that to the plane; the weights of b and c
    on the plane; the place of the closest point along the edges ab, ac, bc; what to add to the
    squared distance to a for that to each edge.
    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.5.
    """
    uu, uv, vv, wu, wv, ww = products = _products(p, a, b, c)
    s, t = _on_plane(products)
    plane = -(s * wu + t * wv)
    wu2 = wu + wu
    wv2 = wv + wv
    ab = (wu / (uu + 1e-300)).clip(0, 1)
    ac = (wv / (vv + 1e-300)).clip(0, 1)
    from_b = uu - wu2
    along = wv - wu + uu - uv
    bc_bc = uu - uv - uv + vv + 1e-300
    bc = (along / bc_bc).clip(0, 1)
    return (
        (ww, plane),
        s,
        t,
        (ab, ac, bc),
        (ab * (ab * uu - wu2), ac * (ac * vv - wv2), bc * (bc * bc_bc - along - along) + from_b),
    )


def lattice(fine: int, whole: bool = False) -> np.ndarray:
    """Barycentric weights (3, g) of a grid on a triangle.

    The triangle's middle comes first, then points inside it, then points on the first half of each
    edge: the neighbor has the other half. whole: on all of each edge. fine: points along an edge.
    """
    inside = [
        (i, j, fine - i - j)
        for i in range(1, fine)
        for j in range(1, fine - i)
        if 3 * i != fine or 3 * j != fine
    ]
    along = range(1, fine if whole else fine // 2 + 1)
    sides = [np.roll((fine - i, i, 0), k) for k in range(3) for i in along]
    return np.concatenate(
        [[(1 / 3, 1 / 3, 1 / 3)], np.reshape([*inside, *sides], (-1, 3)) / fine]
    ).T


def between(
    corners: np.ndarray, faces: np.ndarray, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The points of a lattice on some faces, those on shared edges once.

    corners: (3, m); faces: (j,); grid: (3, g). Returns faces (k,) and barycentric weights (3, k).
    """
    face = np.tile(faces, grid.shape[1])
    weights = np.repeat(grid, len(faces), axis=1)
    on_side = np.flatnonzero((weights == 0).any(axis=0))
    side = weights[:, on_side].argmin(axis=0)
    every = np.arange(len(on_side))
    ends, share = (
        [rows[side - k, every] for k in (2, 1)]
        for rows in (corners.take(face[on_side], 1), weights.take(on_side, 1))
    )
    low = np.round(SIDE_PARTS * np.where(ends[0] < ends[1], *share)).astype(np.intp)
    _, first = np.unique(
        edge_keys(np.stack(ends), corners.max(initial=0) + 1) * (SIDE_PARTS + 1) + low,
        return_index=True,
    )
    once = np.ones(len(face), bool)
    once[np.delete(on_side, first)] = False
    return face[once], weights[:, once]
