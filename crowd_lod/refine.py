"""LOD points moved to where the worst distance between the LOD's surface and its source's is least."""

import numpy as np

from .collapse import edge_keys

WALKS = 8  # steps along a surface to the nearest triangle, at most
FAR = 0.4  # of the worst distance: beyond it a sample's nearest triangle is sought again
KEEP = 0.8  # of a sample's weight for the next move
STRIDE = 0.8  # of each move
FINE = 1e-7  # no moves below this worst distance
SHARPEN = 4.0  # a move adds to a sample's weight its distance, over the worst, to this power


def fit(points, triangles, source, source_triangles, landed, steps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points (n, 3) of a LOD, moved nearer to its source; the distance (k,) found at each of the source's points; on (k, 2):
    the LOD's triangle nearest to each, -1 for none, and its corner farthest from there).

    points (n, 3), triangles (m, 3): the LOD; source (k, 3), source_triangles (j, 3): what it was made of; landed: (k,) the
    LOD's point that each of the source's collapsed into, -1 for none. Distances are those of the source's points to the LOD
    and of the LOD's points and the middles of its triangles and sides to the source, which count for the source's triangle
    nearest to them. Of `steps` moves the best is kept. Each is least squares, weighed by how far the samples were off at
    this and the moves before, towards the least worst distance. Source of that: Lawson, "Contributions to the theory of
    linear least maximum approximation", 1961.
    """
    stars, source_stars = _stars(triangles, len(points)), _stars(source_triangles, len(source))
    mine = np.flatnonzero(landed >= 0)
    there = source[mine]
    face, at = _walk(points, triangles, stars, landed[mine], there)
    own_face, own_at = _samples(triangles, stars)
    here = _mix(points, triangles[own_face], own_at)
    # walks to the source begin at its point nearest to the triangle's middle, and again from a corner's where that ends far
    corner = np.zeros(len(points), np.intp)
    corner[landed[mine]] = mine
    middle = corner[triangles[:, 0]]
    inner = np.lexsort((at.min(axis=1), face))
    middle[face[inner]] = mine[inner]
    hit, hit_at = _walk(source, source_triangles, source_stars, middle[own_face], here)
    for k in range(3):
        away = _length(_mix(source, source_triangles[hit], hit_at) - here)
        far = np.flatnonzero(away > FAR * away.max())
        again, again_at = _walk(source, source_triangles, source_stars, corner[triangles[own_face[far], k]], here[far])
        better = _length(_mix(source, source_triangles[again], again_at) - here[far]) < away[far]
        hit[far[better]], hit_at[far[better]] = again[better], again_at[better]
    best, error, on = points, np.full(len(source), np.inf), np.full((len(source), 2), -1)
    weight = 0.0
    for step in range(steps + 1):
        if step:
            here = _mix(points, triangles[own_face], own_at)
            _again(points, triangles, stars, face, at, there)
            _again(source, source_triangles, source_stars, hit, hit_at, here)
        off = np.concatenate([there - _mix(points, triangles[face], at), _mix(source, source_triangles[hit], hit_at) - here])
        distance = _length(off)
        worst = distance.max()
        if worst < error.max():
            best, error = points, np.zeros(len(source))
            error[mine] = distance[: len(face)]
            on[mine] = np.stack([face, at.argmin(axis=1)], axis=1)
            for end in source_triangles[hit].T:
                np.maximum.at(error, end, distance[len(face) :])
        if step == steps or worst < FINE:
            return best, error, on
        weight = KEEP * weight + (distance / worst) ** SHARPEN
        share = np.concatenate([at, own_at]) * (weight + 1e-4)[:, None]
        corners = triangles[np.concatenate([face, own_face])].ravel()
        total = np.bincount(corners, share.ravel(), len(points)) + 0.05 * share.sum() / len(points)
        move = [np.bincount(corners, (share * off[:, d, None]).ravel(), len(points)) / total for d in range(3)]
        points = _unfolded(points, points + STRIDE * np.stack(move, axis=1), triangles)


def split(points, triangles, landed, error, on, source, count) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points (n + j, 3), triangles (m + 2 j, 3), landed (k,)): j <= `count` of the LOD's sides split, at the source's points
    that are farthest off. The rest as `fit` takes and gives it; each point keeps the source's point nearest to it.
    """
    half = triangles[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2)  # side 3 t + i is opposite of corner i of triangle t
    keys = edge_keys(half.T, len(points))
    order = np.argsort(keys, kind="stable")
    double = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    twin = np.full(len(keys), -1)
    twin[order[double]], twin[order[double + 1]] = order[double + 1], order[double]
    away = np.where(landed < 0, np.inf, _length(source - points[landed]))
    nearest = np.lexsort((away, landed))
    free = on[:, 0] >= 0
    free[nearest[np.unique(landed[nearest], return_index=True)[1]]] = False
    landed, taken, put, new = landed.copy(), np.zeros(len(triangles), bool), [], []
    worst = np.flatnonzero(free)
    for p in worst[np.argsort(-error[worst], kind="stable")][: 20 * count]:
        side = 3 * on[p, 0] + on[p, 1]
        sides = np.array([side, twin[side]])
        if len(put) == count or twin[side] < 0 or taken[sides // 3].any():
            continue
        (a, b), c = half[sides].T, triangles.ravel()[sides]
        was = np.cross(points[a] - points[c], points[b] - points[c])
        halves = [np.cross(source[p] - points[c], points[b] - points[c]), np.cross(points[a] - points[c], source[p] - points[c])]
        if any((np.einsum("nd,nd->n", was, now) < 0.3 * _length(was) * _length(now) + 0.02 * _length(was) ** 2).any() for now in halves):
            continue
        taken[sides // 3] = True
        landed[np.isin(on[:, 0], sides // 3) & free & (_length(source - source[p]) < away)] = middle = len(points) + len(put)
        put.append(source[p])
        new += [corners for k in range(2) for corners in ((c[k], a[k], middle), (c[k], middle, b[k]))]
    new = np.array(new, triangles.dtype).reshape(-1, 3)
    return np.concatenate([points, np.reshape(put, (-1, 3))]), np.concatenate([triangles[~taken], new]), landed


def _again(points, triangles, stars, face, at, others) -> None:
    """Bring `face` and `at` up to date for those of `others` that are farthest from them."""
    distance = _length(others - _mix(points, triangles[face], at))
    far = np.flatnonzero(distance > FAR * distance.max())
    start = triangles[face[far], at[far].argmax(axis=1)]
    face[far], at[far] = _walk(points, triangles, stars, start, others[far])


def _walk(points, triangles, stars, start, others) -> tuple[np.ndarray, np.ndarray]:
    """(triangle (k,), barycentric coordinates on it (k, 3)) nearest to each of `others` (k, 3), found by going from the
    point `start` (k,) to the nearest of the triangles round it, to its nearest corner, and on while that gets nearer."""
    face, at = _nearest(points, triangles, stars, start, others)
    going = np.arange(len(start))
    for _ in range(WALKS):
        corner = triangles[face[going], at[going].argmax(axis=1)]
        going, corner = going[corner != start[going]], corner[corner != start[going]]
        if not len(going):
            break
        start[going] = corner
        face[going], at[going] = _nearest(points, triangles, stars, corner, others[going])
    return face, at


def _nearest(points, triangles, stars, start, others) -> tuple[np.ndarray, np.ndarray]:
    """(triangle (k,), barycentric coordinates on it (k, 3)) nearest to each of `others` (k, 3), of the triangles round the
    points `start` (k,)."""
    star, first = stars
    count = (first[1:] - first[:-1])[start]
    begin = np.cumsum(count) - count
    which = np.repeat(np.arange(len(start)), count)
    face = star[np.arange(len(which)) + np.repeat(first[start] - begin, count)]
    corners = triangles[face]
    at = _barycentric(others[which], *(points[corners[:, i]] for i in range(3)))
    off = others[which] - _mix(points, corners, at)
    distance = np.einsum("nd,nd->n", off, off)
    hit = np.flatnonzero(distance == np.repeat(np.minimum.reduceat(distance, begin), count))
    hit = hit[np.searchsorted(which[hit], np.arange(len(start)))]
    return face[hit], at[hit]


def _samples(triangles, stars) -> tuple[np.ndarray, np.ndarray]:
    """(triangle (k,), barycentric coordinates (k, 3)) of the middles of all triangles and sides, and of the points."""
    star, first = stars
    every, at = [np.arange(len(triangles))], [np.full((len(triangles), 3), 1 / 3)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        every.append(np.flatnonzero(triangles[:, i] < triangles[:, j]))  # a side of two triangles once
        at.append(np.tile((np.arange(3) == i) / 2 + (np.arange(3) == j) / 2, (len(every[-1]), 1)))
    one = star[first[:-1]]
    return np.concatenate([*every, one]), np.concatenate([*at, triangles[one] == np.arange(len(first) - 1)[:, None]])


def _stars(triangles, n) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of each of n points, one point's after another's, and where each one's begin (n + 1,)."""
    corner = triangles.ravel()
    return np.argsort(corner, kind="stable") // 3, np.concatenate([[0], np.cumsum(np.bincount(corner, minlength=n))])


def _length(vectors) -> np.ndarray:
    return np.sqrt(np.einsum("nd,nd->n", vectors, vectors))


def _mix(points, corners, at) -> np.ndarray:
    """The points (k, 3) at barycentric coordinates (k, 3) of the corners (k, 3)."""
    return sum(at[:, i, None] * points[corners[:, i]] for i in range(3))


def _barycentric(p, a, b, c) -> np.ndarray:
    """Barycentric coordinates (k, 3) of the points of the triangles abc nearest to p, each (k, 3).

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.5.
    """
    u, v, w = b - a, c - a, p - a
    uu, uv, vv, wu, wv = (np.einsum("nd,nd->n", *pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = uu * vv - uv * uv + 1e-300
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    out = np.flatnonzero((s < 0) | (t < 0) | (s + t > 1))
    uu, uv, vv, wu, wv = uu[out], uv[out], vv[out], wu[out], wv[out]
    # the nearest points on the sides, and the nearest of these
    ab, ac = (wu / (uu + 1e-300)).clip(0, 1), (wv / (vv + 1e-300)).clip(0, 1)
    bc = ((wv - wu + uu - uv) / (uu - 2 * uv + vv + 1e-300)).clip(0, 1)
    side_s, side_t = np.stack([ab, 0 * ab, 1 - bc]), np.stack([0 * ac, ac, bc])
    away = side_s**2 * uu + 2 * side_s * side_t * uv + side_t**2 * vv - 2 * (side_s * wu + side_t * wv)
    side = away.argmin(axis=0), np.arange(len(out))
    s[out], t[out] = side_s[side], side_t[side]
    return np.stack([1 - s - t, s, t], axis=1)


def _unfolded(old, new, triangles) -> np.ndarray:
    """`new` but for the points of triangles that would turn over or shrink to slivers: those stay at `old`."""
    normal = lambda p: np.cross(p[triangles[:, 1]] - p[triangles[:, 0]], p[triangles[:, 2]] - p[triangles[:, 0]])  # noqa: E731
    was = normal(old)
    for _ in range(20):
        now = normal(new)
        along = np.einsum("nd,nd->n", was, now)
        bad = (along < 0.8 * _length(was) * _length(now)) | (along < 0.2 * (was**2).sum(axis=1))
        stay = np.unique(triangles[bad])
        stay = stay[(new[stay] != old[stay]).any(axis=1)]
        if not len(stay):
            return new
        new[stay] = old[stay]
    return old
