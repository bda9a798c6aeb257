"""Loose parts of a mesh: they give triangles up, where collapses elsewhere would cost more.

Those that stay are widened until each shows as much as before.
"""

from copy import copy
from heapq import heapify, heappop, heappush

import numpy as np

from ..mesh import connected_components
from .closest_point import distances
from .collapse_choice import AREA_POWER
from .rasterizer import covered
from .triangle_mesh import blocks, length, normals

# A point of the source that a collapse leaves behind counts with this part of the distance: the
# fit brings the surfaces nearer afterwards.
FITTED = 0.25
# A part is replaced by one that is LARGER times its size, if it lies within NEAR times its own
# radius of that.
LARGER = 4.0
NEAR = 4.0

PAIRS_AT_ONCE = 4_000_000  # pairs of a part and a point that are compared at a time
GOLDEN = (np.sqrt(5) - 1) / 2  # fractions of its multiples spread evenly from 0 to 1
LOST = 0.03  # part of the source's silhouette: a part that lacks more is widened
FLAT = 0.01  # a part whose thickness is less than this part of its length is flat
CELL = 32  # pixels across the mask of a part, with one around it
# From where parts are looked at: the corners of a cube, (d, 2, 3) axes of the pictures.
_towards = np.array([(1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]) / np.sqrt(3)
_right = np.cross((0.0, 0.0, 1.0), _towards) * np.sqrt(1.5)
DIRECTIONS = np.stack([_right, np.cross(_towards, _right)], axis=1)


class LooseParts:
    """The loose parts of a mesh. All but the largest may go.

    A closed part cannot collapse to fewer than four triangles, nor one with holes to so few. Beside
    many small parts the largest would go on collapsing until nothing is left of it. So the error
    of each part if it were gone is compared with the costs of the next collapses: squared distances
    in all copies, weighed by area as quadrics are. Quadrics do not tell that a thin end gets
    shorter. So each point also follows a point of the source, its witness.

    part: (n,) the number of each point's part, from the largest on.
    """

    def __init__(self, copies: int, rest: np.ndarray, corners: np.ndarray, area: np.ndarray):
        """The parts of a mesh, none given up.

        copies: of the mesh, at rest and in each pose; rest: (3, n), its points; corners: (3, m), of
        its triangles, which use all points; area: (n,), of each point, as in its quadric.
        """
        self.part, middle, radius = _parts(rest, corners)
        count = len(radius)
        faces = normals(*(rest.take(corner, 1) for corner in corners))
        silhouette = np.bincount(self.part[corners[0]], length(faces), count) / 8
        weight = np.bincount(self.part, area, count) ** (1 - AREA_POWER)
        lost = _lost_distances(rest, self.part, middle, radius)
        self._costs = weight * copies * np.maximum(lost**2, silhouette)
        self._copies = copies
        self._witness = rest.copy()

    def of(self, points: np.ndarray) -> "LooseParts":
        """The same of a mesh that has the `points` (k,) alone."""
        other = copy(self)
        other.part = self.part[points]
        other._costs = self._costs.copy()
        other._witness = self._witness.take(points, 1)
        return other

    @property
    def cheapest(self) -> float:
        """The least cost of a part that may be given up, infinite if there is none."""
        return float(self._costs.min())

    def true_costs(
        self,
        points: np.ndarray,
        corners: np.ndarray,
        ends: np.ndarray,
        at: np.ndarray,
        area: np.ndarray,
    ) -> np.ndarray:
        """The costs (k,) of collapses by how far they leave the points' witnesses behind.

        points: (3, n), corners: (3, m), as they are; ends: (2, k) edges without a common face; at:
        (3, k), where they collapse to; area: (n,), of each point, as in its quadric.
        """
        edge_of = np.full(points.shape[1], -1)
        edge_of[ends] = np.arange(ends.shape[1])
        mine = edge_of[corners]
        stays = (mine >= 0).sum(axis=0) == 1
        mine = mine[:, stays]
        corners = corners[:, stays]
        edge = mine.max(axis=0)
        faces = [
            np.where(own >= 0, at.take(edge, 1), points.take(corner, 1))
            for own, corner in zip(mine, corners, strict=True)
        ]
        away = np.full(ends.shape, np.inf)
        for nearest, end in zip(away, ends, strict=True):
            np.minimum.at(nearest, edge, distances(self._witness.take(end[edge], 1), *faces))
        off = FITTED * away.max(axis=0)
        return self._copies * off**2 * area[ends].sum(axis=0) ** (1 - AREA_POWER)

    def follow(self, ends: np.ndarray, at: np.ndarray) -> None:
        """Note that edges `ends` (2, k) have become their first ends, at the places `at` (3, k).

        Of the two witnesses the one farther off stays.
        """
        first, second = (self._witness.take(end, 1) for end in ends)
        self._witness[:, ends[0]] = np.where(
            length(first - at) < length(second - at), second, first
        )

    def give_up(self, corners: np.ndarray, limit: float, excess: int) -> np.ndarray:
        """Remove parts, at a cost of `limit` at most each.

        corners: (3, m), of the triangles there are; excess: how many of them are too many. The
        cheapest parts go first, until as many triangles are freed. Returns the corners (3, k) that
        are left.
        """
        part = self.part[corners[0]]
        freed = np.bincount(part, minlength=len(self._costs))
        due = np.flatnonzero((self._costs <= limit) & (self._costs < np.inf))
        due = due[np.argsort(self._costs[due], kind="stable")]
        due = due[: np.searchsorted(np.cumsum(freed[due]), excess) + 1]
        self._costs[due] = np.inf
        return corners.compress(~np.isin(part, due), axis=1)


def _parts(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The loose parts of a mesh, numbered from the largest on.

    points: (3, n); corners: (3, m). Returns the number of each point's part (n,), and the middles
    (3, parts) and radii (parts,) of their bounding boxes.
    """
    first, part = np.unique(connected_components(points.shape[1], corners.T), return_inverse=True)
    low = np.full((3, len(first)), np.inf)
    high = -low
    for k in range(3):
        np.minimum.at(low[k], part, points[k])
        np.maximum.at(high[k], part, points[k])
    radius = length(high - low) / 2
    by_size = np.argsort(-radius, kind="stable")
    return np.argsort(by_size)[part], (low + high)[:, by_size] / 2, radius[by_size]


def _lost_distances(
    points: np.ndarray, part: np.ndarray, middle: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """The error of the picture once each part is gone, (parts,), infinite for the largest.

    points: (3, n); part: (n,); middle: (3, parts), radius: (parts,).

    Once a part is gone, a larger one stands in for it: one of many times its size if there is such
    a one nearby, else the nearest. If that part goes before, its own stand-in serves. A part that
    stands in for others which are gone has their distance added to its error. So of parts that are
    alike first every second goes, then every second of those left.
    Source: Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985, has the
    measure.
    """
    order = np.argsort(part, kind="stable")
    points = points.take(order, 1)
    first = np.searchsorted(part[order], np.arange(len(radius)))
    nearest, gap = _nearest_points(points, first, middle)
    larger = first[np.searchsorted(-radius, -LARGER * radius)]
    near, away = _nearest_points(points, larger, middle)
    at_larger = away + radius < NEAR * radius
    stand_in = part[order[np.where(at_larger, near, nearest)]]
    return _lost_in_turn(np.where(at_larger, away, gap) + radius, stand_in)


def _nearest_points(
    points: np.ndarray, count: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of the first `count` points the one nearest to each of those `targets`.

    points: (3, n); count: (k,), ascending; targets: (3, k). Returns indices and distances (k,): 0
    and infinite of none.
    """
    nearest = np.zeros(len(count), np.intp)
    away = np.full(len(count), np.inf)
    square = np.einsum("dn,dn->n", points, points)
    for block in blocks(len(count), max(1, PAIRS_AT_ONCE // len(square))):
        most = count[block][-1]
        if most:
            squares = square[:most] - 2 * targets[:, block].T @ points[:, :most]
            squares[np.arange(most) >= count[block, None]] = np.inf
            nearest[block] = squares.argmin(axis=1)
            away[block] = np.where(
                count[block] > 0, length(targets[:, block] - points.take(nearest[block], 1)), np.inf
            )
    return nearest, away


def _lost_in_turn(off: np.ndarray, stand_in: np.ndarray) -> np.ndarray:
    """The error of each part once it is gone, (parts,), if the least goes first.

    off: (parts,) distance from the larger part that stands in for it, stand_in: (parts,), which
    that is: see _lost_distances().
    """
    off = off.copy()
    stand_in = stand_in.copy()
    lost = np.full(len(off), np.inf)
    behind = np.zeros(len(off))
    waiting = [(off[k], k * GOLDEN % 1, k) for k in range(1, len(off))]
    heapify(waiting)
    while waiting:
        estimate, turn, k = heappop(waiting)
        while lost[stand_in[k]] < np.inf:
            off[k] += off[stand_in[k]]
            stand_in[k] = stand_in[stand_in[k]]
        if off[k] + behind[k] > estimate:
            heappush(waiting, (off[k] + behind[k], turn, k))
            continue
        lost[k] = estimate
        behind[stand_in[k]] = max(behind[stand_in[k]], estimate)
    return lost


def widened(
    points: np.ndarray,
    triangles: np.ndarray,
    part: np.ndarray,
    target_areas: np.ndarray,
    most: float,
) -> np.ndarray:
    """Widen parts that show too little, and return the points (n, 3).

    A part is widened about its middle, by the same length along each of its own axes.
    points: (n, 3); triangles: (m, 3); part: (n,) the number of each point's part; target_areas:
    (p,) that the parts should show; most: length by which a part may be widened.
    """
    count = len(target_areas)
    middle = (
        np.stack([np.bincount(part, x, count) for x in points.T], axis=1)
        / np.bincount(part, minlength=count)[:, None]
    )
    off = points - middle[part]
    spread = [np.bincount(part, off[:, i] * off[:, j], count) for i in range(3) for j in range(3)]
    axes = np.linalg.eigh(np.stack(spread, axis=1).reshape(-1, 3, 3))[1]
    along = np.einsum("nd,ndk->nk", off, axes[part])
    reach = np.zeros((count, 3))  # the shortest first
    np.maximum.at(reach, part, np.abs(along))
    more = (
        target_areas
        / np.maximum(silhouette_areas(points, triangles, part[triangles[:, 0]], count), 1e-300)
        - 1
    )
    more[more < LOST] = 0
    # as a box grows: (a + d) (b + d) + (b + d) (c + d) + (c + d) (a + d) is 1 + more times ab + bc
    # + ca; of what is flat (b + d) (c + d)
    (a, b, c) = reach.T
    flat = reach[:, 0] < FLAT * reach[:, 2]
    square, line, area = np.where(
        flat,
        (np.ones(count), b + c, b * c),
        (np.full(count, 3.0), 2 * (a + b + c), a * b + b * c + c * a),
    )
    wider = (np.sqrt(line**2 + 4 * square * area * more) - line) / (2 * square)
    scale = 1 + wider.clip(0, most)[:, None] / np.maximum(reach, FLAT * reach[:, 2:] + 1e-300)
    return middle[part] + np.einsum("nk,ndk->nd", along * scale[part], axes[part])


def silhouette_areas(
    points: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int, cell: int = CELL
) -> np.ndarray:
    """The area (count,) of each part's silhouette, in the mean of DIRECTIONS.

    points: (n, 3); triangles: (m, 3); part: (m,) of each triangle, one at least of each part; cell:
    pixels across a part.
    """
    total = np.zeros(count)
    across = int(np.ceil(np.sqrt(count)))
    for axes in DIRECTIONS:
        flat = (points @ axes.T)[triangles]
        low = np.full((count, 2), np.inf)
        high = np.full((count, 2), -np.inf)
        np.minimum.at(low, part, flat.min(axis=1))
        np.maximum.at(high, part, flat.max(axis=1))
        size = np.maximum(high - low, 1e-300)
        place = np.stack([np.arange(count) % across, np.arange(count) // across], axis=1)
        at = ((flat - low[part, None]) / size[part, None] * (cell - 2) + 1) + cell * place[
            part, None
        ]
        mask = covered(at, (across * cell, across * cell))
        pixels = mask.reshape(across, cell, across, cell).sum(axis=(1, 3)).ravel()
        total += pixels[:count] * size.prod(axis=1)
    return total / (cell - 2) ** 2 / len(DIRECTIONS)
