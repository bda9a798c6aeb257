"""Nearest points of a mesh, found by walking over its triangles from where others were found before."""

import numpy as np

BLOCK = 16_000  # triangles looked at together
WALKS = 40  # steps along a surface to the nearest triangle, at most
FAR = 0.5  # of the largest distance: beyond it a point's nearest triangle is sought again
DOUBTS = 12  # times that those farthest off are doubted, at most, while any of them was wrong
DOUBTED = 32  # points farthest off, whose walks may have ended at a wrong place


class Walkable:
    """A mesh on which nearest points are found by walking. points: (3, n); corners: (3, m) indices; star, first: the
    triangles of each point, one point's after another's, and where each one's begin (n + 1,). Columns, not rows: NumPy is
    several times faster along the long axis."""

    def __init__(self, points: np.ndarray, corners: np.ndarray):
        self.points, self.corners = points, corners
        self._spheres = None
        self.star = np.argsort(corners.ravel(), kind="stable") % corners.shape[1]
        self.first = np.concatenate([[0], np.cumsum(np.bincount(corners.ravel(), minlength=points.shape[1]))])

    @classmethod
    def of(cls, points: np.ndarray, triangles: np.ndarray) -> "Walkable":
        """Of points (n, 3) and triangles (m, 3)."""
        return cls(np.ascontiguousarray(points.T), np.ascontiguousarray(triangles.T))

    def at(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The points (3, k) at barycentric weights (3, k) of the triangles `face` (k,)."""
        return sum(self.points.take(c, 1) * w for c, w in zip(self.corners.take(face, 1), weights, strict=True))

    def corner(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The corner (k,) nearest to each of such points."""
        return self.corners[weights.argmax(axis=0), face]

    def walk(self, start: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(triangle (k,), barycentric weights on it (3, k)) nearest to each of `others` (3, k), by going from the point
        `start` (k,) to the nearest of the triangles round it, to its nearest corner, and on while that gets nearer."""
        face, weights = self._round(start, others)
        going = np.arange(len(start))
        for _ in range(WALKS):
            corner = self.corner(face[going], weights.take(going, 1))
            moved = corner != start[going]
            going, corner = going[moved], corner[moved]
            if not len(going):
                break
            start[going] = corner
            face[going], weights[:, going] = self._round(corner, others.take(going, 1))
        return face, weights

    def follow(self, face: np.ndarray, weights: np.ndarray, others: np.ndarray, walk=True) -> tuple[np.ndarray, np.ndarray]:
        """(ways (3, k) from the nearest points to `others`, their lengths (k,)), with `face` and `weights` brought up to date for
        those that are farthest off: on their triangles, and with `walk` by walks from the sides of these."""
        off = others - self.at(face, weights)
        distance = length(off)
        far = np.flatnonzero(distance > FAR * distance.max(initial=0))
        there = others.take(far, 1)
        at = barycentric(there, *(self.points.take(c, 1) for c in self.corners.take(face[far], 1)))
        weights[:, far] = at
        side = np.flatnonzero((at <= 0).any(axis=0) & walk)
        face[far[side]], weights[:, far[side]] = self.walk(self.corner(face[far[side]], at.take(side, 1)), there.take(side, 1))
        off[:, far] = there - self.at(face[far], weights.take(far, 1))
        distance[far] = length(off.take(far, 1))
        return off, distance

    def doubt(self, face: np.ndarray, weights: np.ndarray, others: np.ndarray, count: int = DOUBTED) -> None:
        """Seek those of `others` that are farthest from `face` and `weights` again, on all triangles near enough."""
        middle, radius = self.spheres
        for _ in range(DOUBTS if len(face) else 0):
            distance = length(others - self.at(face, weights))
            far = np.argpartition(-distance, min(count, len(distance)) - 1)[:count]
            far = far[distance[far] > distance[far].max() / 2]
            some = others.take(far, 1)
            away = np.sqrt(sum((x[:, None] - y) ** 2 for x, y in zip(some.astype(np.float32), middle, strict=True)))
            most = np.minimum((away + radius).min(axis=1), distance[far])[:, None]
            which, found = np.nonzero(away - radius < most + 1e-6)
            other = some.take(which, 1)
            at = barycentric(other, *(self.points.take(c, 1) for c in self.corners.take(found, 1)))
            away = length(other - self.at(found, at))
            order = np.lexsort((away, which))
            which, first = np.unique(which[order], return_index=True)
            best = order[first]
            better = away[best] < 0.99 * distance[far[which]]
            if not better.any():
                break
            face[far[which[better]]], weights[:, far[which[better]]] = found[best[better]], at.take(best[better], 1)

    def beyond(self, least: float, face: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(which of `others` (3, k) are farther than `least`, the triangles nearest to these, the weights on them), by walks
        from the triangles `face` (k,)."""
        weights = barycentric(others, *(self.points.take(c, 1) for c in self.corners.take(face, 1)))
        far = np.flatnonzero(length(others - self.at(face, weights)) > least)
        others = others.take(far, 1)
        face, weights = self.walk(self.corner(face[far], weights.take(far, 1)), others)
        self.doubt(face, weights, others)
        still = np.flatnonzero(length(others - self.at(face, weights)) > least)
        return far[still], face[still], weights.take(still, 1)

    @property
    def spheres(self) -> tuple[np.ndarray, np.ndarray]:
        """(middles (3, m), radii (m,)) of spheres about the triangles."""
        if self._spheres is None or self._spheres[2] is not self.points:
            corner = [self.points.take(c, 1) for c in self.corners]
            middle = sum(corner) / 3
            radius = np.max([length(each - middle) for each in corner], axis=0)
            self._spheres = middle.astype(np.float32), radius.astype(np.float32), self.points
        return self._spheres[:2]

    def _round(self, start: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As walk(), of the triangles round the points `start` (k,) alone."""
        face, weights = np.empty(len(start), np.intp), np.empty((3, len(start)))
        for block in blocks(len(start), BLOCK // 8):
            face[block], weights[:, block] = self._nearest_round(start[block], others[:, block])
        return face, weights

    def _nearest_round(self, start: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        begin = self.first[start]
        count = self.first[start + 1] - begin
        low = np.cumsum(count) - count
        which = np.repeat(np.arange(len(start)), count)
        face = self.star[np.arange(len(which)) + np.repeat(begin - low, count)]
        weights, square = nearest_on(others.take(which, 1), *(self.points.take(c, 1) for c in self.corners.take(face, 1)))
        hit = np.flatnonzero(square == np.repeat(np.minimum.reduceat(square, low), count))
        hit = hit[np.searchsorted(which[hit], np.arange(len(start)))]
        return face[hit], weights.take(hit, 1)


def blocks(count: int, size: int) -> list[slice]:
    """Slices of `size` that make up range(count): NumPy is some three times faster on arrays that fit in the cache."""
    return [slice(k, k + size) for k in range(0, count, size)]


def length(vectors: np.ndarray) -> np.ndarray:
    """Of vectors (3, k)."""
    return np.sqrt(np.einsum("dn,dn->n", vectors, vectors))


def normals(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Of triangles abc, each (3, k), as long as twice their area."""
    (ux, uy, uz), (vx, vy, vz) = b - a, c - a
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])


def barycentric(p, a, b, c) -> np.ndarray:
    """Barycentric weights (3, k) of the points of the triangles abc nearest to p, each (3, k)."""
    weights = np.empty(p.shape)
    for block in blocks(p.shape[1], BLOCK):
        weights[:, block] = nearest_on(*(each[:, block] for each in (p, a, b, c)))[0]
    return weights


def nearest_on(p, a, b, c) -> tuple[np.ndarray, np.ndarray]:
    """(barycentric weights (3, k), squared distances (k,)) of the points of the triangles abc nearest to p, each (3, k).

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.5.
    """
    u, v, w = b - a, c - a, p - a
    uu, uv, vv, wu, wv, ww = (np.einsum("dn,dn->n", *pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v), (w, w)))
    area = uu * vv - uv * uv + 1e-300
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    square = -(s * wu + t * wv)
    # beyond a side, the nearest point on that
    ab, ac = (wu / (uu + 1e-300)).clip(0, 1), (wv / (vv + 1e-300)).clip(0, 1)
    bc = ((wv - wu + uu - uv) / (uu - 2 * uv + vv + 1e-300)).clip(0, 1)
    sides = ((t < 0, ab, 0 * ab), (s < 0, 0 * ac, ac), (s + t > 1, 1 - bc, bc))
    least = np.full(len(s), np.inf)
    for beyond, side_s, side_t in sides:
        away = side_s * (side_s * uu + 2 * side_t * uv - 2 * wu) + side_t * (side_t * vv - 2 * wv)
        nearer = beyond & (away < least)
        least, s, t = (np.where(nearer, one, other) for one, other in ((away, least), (side_s, s), (side_t, t)))
    return np.stack([1 - s - t, s, t]), np.maximum(ww + np.where(least < np.inf, least, square), 0)
