"""Quadrics of a mesh's vertices, and what collapses of its edges cost by them.

Source: Garland, Heckbert, "Surface simplification using quadric error metrics", 1997.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .closest_point import BLOCK
from .pose_deformation import Skin
from .triangle_mesh import blocks, half_edges

# A collapse's error is divided by its area to this power: 0 spares large faces, 1 treats all alike.
AREA_POWER = 0.9
# weight of an edge's middle against the planes: decides where they leave a choice
MIDPOINT = 1e-9


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
    hold: float = 1.0,
) -> np.ndarray:
    """Each vertex's quadric (11, n): xx, xy, xz, yy, yz, zz, xd, yd, zd, dd, area.

    It sums the planes of the faces at the vertex, by their areas, and the planes upright on its
    constrained edges, by their lengths squared. points: (n, 3); triangles: (m, 3); constrained: see
    constrained_edges(); hold: weight of seams, of that of borders.
    """
    n = len(points)
    sides, is_border = constrained
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal, area = _unit(np.cross(b - a, c - a))
    total = _spread(_planes(normal, a, area / 2), triangles.T, n)
    start, end = half_edges(triangles)[sides].T
    upright, length = _unit(np.cross(points[end] - points[start], normal[sides // 3]))
    weight = np.where(is_border, 1, hold) * length**2
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
    hold = MIDPOINT * area + 1e-300
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
