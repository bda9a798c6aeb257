"""Nearest points of a mesh, found by walking over its triangles from where others were found before."""

import numpy as np

from . import settings

BLOCK = 16_000  # triangles looked at together


class TriangleMesh:
    """A mesh on which nearest points are found by walking. points: (3, n); corners: (3, m) indices; vertex_faces, first: the
    triangles of each point, one point's after another's, and where each one's begin (n + 1,). Columns, not rows: NumPy is
    several times faster along the long axis."""

    def __init__(self, points: np.ndarray, corners: np.ndarray):
        self.points, self.corners = points, corners
        self._spheres = None
        self.vertex_faces = np.argsort(corners.ravel(), kind="stable") % corners.shape[1]
        self.first = np.concatenate([[0], np.cumsum(np.bincount(corners.ravel(), minlength=points.shape[1]))])

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
        for _ in range(settings.CURRENT.walk_steps):
            corner = self.corner(face[going], weights.take(going, 1))
            moved = corner != start[going]
            going, corner = going[moved], corner[moved]
            if not len(going):
                break
            start[going] = corner
            face[going], weights[:, going] = self._round(corner, others.take(going, 1))
        return face, weights

    def follow(self, face: np.ndarray, weights: np.ndarray, others: np.ndarray, walk=True) -> tuple[np.ndarray, np.ndarray]:
        """(ways (3, k) from the nearest points to `others`, their lengths (k,)), with `weights` brought up to date on the triangles
        `face`, and with `walk` both for those that are farthest off, by walks from the sides of these."""
        off = others - self.at(face, weights)
        distance = length(off)
        far = np.flatnonzero(distance > settings.CURRENT.walk_again * distance.max(initial=0))
        there = others.take(far, 1)
        at = closest_weights(there, *(self.points.take(c, 1) for c in self.corners.take(face[far], 1)))
        weights[:, far] = at
        side = np.flatnonzero((at <= 0).any(axis=0) & walk)
        face[far[side]], weights[:, far[side]] = self.walk(self.corner(face[far[side]], at.take(side, 1)), there.take(side, 1))
        off[:, far] = there - self.at(face[far], weights.take(far, 1))
        distance[far] = length(off.take(far, 1))
        return off, distance

    def doubt(self, face: np.ndarray, weights: np.ndarray, others: np.ndarray, count: int | None = None) -> None:
        """Seek those of `others` that are farthest from `face` and `weights` again, on all triangles near enough."""
        sorted_by, along, middle, radius = self.spheres
        count = count or settings.CURRENT.doubt_points
        distance = length(others - self.at(face, weights))
        for _ in range(settings.CURRENT.doubt_rounds if len(face) else 0):
            far = np.argpartition(-distance, min(count, len(distance)) - 1)[:count]
            far = far[distance[far] > distance[far].max() / 2]
            some, most = others.take(far, 1), distance[far] + 1e-6
            reach = most + radius.max()
            begin, end = (np.searchsorted(middle[along], some[along] + side) for side in (-reach, reach))
            which, found = np.repeat(np.arange(len(far)), end - begin), ranges(begin, end - begin)
            away = length(some.take(which, 1) - middle.take(found, 1))
            np.minimum.at(most, which, away + radius[found] + 1e-6)
            near = away - radius[found] < most[which]
            which, found = which[near], sorted_by[found[near]]
            other = some.take(which, 1)
            at = closest_weights(other, *(self.points.take(c, 1) for c in self.corners.take(found, 1)))
            away = length(other - self.at(found, at))
            order = np.lexsort((away, which))
            which, first = np.unique(which[order], return_index=True)
            best = order[first]
            better = away[best] < 0.99 * distance[far[which]]
            if not better.any():
                break
            best, far = best[better], far[which[better]]
            face[far], weights[:, far], distance[far] = found[best], at.take(best, 1), away[best]

    def beyond(self, least: float, face: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(which of `others` (3, k) are farther than `least`, the triangles nearest to these, the weights on them), by walks
        from the triangles `face` (k,)."""
        far = np.flatnonzero(distances(others, *(self.points.take(c, 1) for c in self.corners.take(face, 1))) > least)
        others = others.take(far, 1)
        corners = self.corners.take(face[far], 1)
        near = np.argmin([length(others - self.points.take(c, 1)) for c in corners], axis=0)
        face, weights = self.walk(corners[near, np.arange(len(far))], others)
        self.doubt(face, weights, others)
        still = np.flatnonzero(length(others - self.at(face, weights)) > least)
        return far[still], face[still], weights.take(still, 1)

    @property
    def spheres(self) -> tuple[np.ndarray, int, np.ndarray, np.ndarray]:
        """(the triangles in order along an axis (m,), the axis, middles (3, m) and radii (m,) of spheres about them)."""
        if self._spheres is None or self._spheres[0] is not self.points:
            corner = [self.points.take(c, 1) for c in self.corners]
            middle = sum(corner) / 3
            radius = np.max([length(each - middle) for each in corner], axis=0)
            along = int(np.ptp(middle, axis=1).argmax())
            order = np.argsort(middle[along])
            self._spheres = self.points, (order, along, middle.take(order, 1), radius[order])
        return self._spheres[1]

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
        face = self.vertex_faces[ranges(begin, count)]
        square = squares(others.take(which, 1), *(self.points.take(c, 1) for c in self.corners.take(face, 1)))
        hit = np.flatnonzero(square == np.repeat(np.minimum.reduceat(square, low), count))
        face = face[hit[np.searchsorted(which[hit], np.arange(len(start)))]]
        return face, _closest_weights(others, *(self.points.take(c, 1) for c in self.corners.take(face, 1)))


def blocks(count: int, size: int) -> list[slice]:
    """Slices of `size` that make up range(count): NumPy is some three times faster on arrays that fit in the cache."""
    return [slice(k, k + size) for k in range(0, count, size)]


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """first[0], first[0] + 1, ... count[0] of them, then those from first[1]."""
    return np.arange(count.sum()) + np.repeat(first - np.cumsum(count) + count, count)


def length(vectors: np.ndarray) -> np.ndarray:
    """Of vectors (3, k)."""
    return np.sqrt(np.einsum("dn,dn->n", vectors, vectors))


def normals(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Of triangles abc, each (3, k), as long as twice their area."""
    (ux, uy, uz), (vx, vy, vz) = b - a, c - a
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])


def barycentric(p, a, b, c) -> np.ndarray:
    """Barycentric weights (3, k) of the points p dropped onto the planes of the triangles abc, each (3, k): thirds where a
    triangle has no area."""
    products = _products(p, a, b, c)
    uu, uv, vv = products[:3]
    s, t = _on_plane(*products)
    flat = uu * vv - uv * uv <= 1e-12 * uu * vv
    s[flat] = t[flat] = 1 / 3
    return np.stack([1 - s - t, s, t])


def closest_weights(p, a, b, c) -> np.ndarray:
    """Barycentric weights (3, k) of the points of the triangles abc nearest to p, each (3, k)."""
    weights = np.empty(p.shape)
    for block in blocks(p.shape[1], BLOCK):
        weights[:, block] = _closest_weights(*(each[:, block] for each in (p, a, b, c)))
    return weights


def distances(p, a, b, c) -> np.ndarray:
    """Distances (k,) of p to the triangles abc, each (3, k)."""
    square = np.empty(p.shape[1])
    for block in blocks(p.shape[1], BLOCK):
        square[block] = squares(*(each[:, block] for each in (p, a, b, c)))
    return np.sqrt(square)


def _closest_weights(p, a, b, c) -> np.ndarray:
    """As closest_weights(), all at once."""
    _, s, t, (ab, ac, bc), (on_ab, on_ac, on_bc) = _planes_and_sides(p, a, b, c)
    # no where(): the processor cannot foresee which
    inside = np.minimum(np.minimum(s, t), 1 - s - t) >= 0
    one = (on_ab <= on_ac) & (on_ab <= on_bc)
    last = ~one & (on_bc < on_ac) & ~inside
    two = ~(one | last | inside)
    one &= ~inside
    s, t = s * inside + ab * one + (1 - bc) * last, t * inside + ac * two + bc * last
    return np.stack([1 - s - t, s, t])


def squares(p, a, b, c) -> np.ndarray:
    """Squared distances (k,) of p to the nearest points of the triangles abc, each (3, k)."""
    (ww, plane), s, t, _, away = _planes_and_sides(p, a, b, c)
    sides = np.minimum(np.minimum(*away[:2]), away[2])
    inside = np.minimum(np.minimum(s, t), 1 - s - t) >= 0
    return np.maximum(ww + sides + inside * (plane - sides), 0)


def _products(p, a, b, c) -> list[np.ndarray]:
    """Dot products (k,) of u = b - a, v = c - a and w = p - a: uu, uv, vv, wu, wv, ww."""
    u, v, w = b - a, c - a, p - a
    return [np.einsum("dn,dn->n", *pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v), (w, w))]


def _on_plane(uu, uv, vv, wu, wv, _) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights (k,) of b and of c, of the point of the triangle's plane nearest to p."""
    area = uu * vv - uv * uv + 1e-300
    return (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area


def _planes_and_sides(p, a, b, c) -> tuple[tuple, np.ndarray, np.ndarray, tuple, tuple]:
    """((squared distances to a, what is added to these on the plane), barycentric weights on the plane of b, of c, how far
    along the sides ab, ac, bc the nearest points on these are, what is added on these), each (k,).

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.5.
    """
    uu, uv, vv, wu, wv, ww = products = _products(p, a, b, c)
    s, t = _on_plane(*products)
    plane = -(s * wu + t * wv)
    wu2, wv2 = wu + wu, wv + wv
    ab, ac = (wu / (uu + 1e-300)).clip(0, 1), (wv / (vv + 1e-300)).clip(0, 1)
    from_b = uu - wu2
    along = wv - wu + uu - uv
    bc_bc = uu - uv - uv + vv + 1e-300
    bc = (along / bc_bc).clip(0, 1)
    return (ww, plane), s, t, (ab, ac, bc), (ab * (ab * uu - wu2), ac * (ac * vv - wv2), bc * (bc * bc_bc - along - along) + from_b)
