"""Quadric edge collapse, in rounds.

Each round collapses, the cheapest first, edges so far apart that they share no face at their ends.
"""

from collections.abc import Iterator
from copy import copy
from typing import NamedTuple

import numpy as np

from ..mesh import Mesh
from .collapse_choice import (
    CollapsingMesh,
    Edges,
    PoseErrors,
    Poses,
    are_bridges,
    are_flat,
    choose_collapses,
    in_ring,
    place_collapses,
)
from .loose_parts import LooseParts
from .triangle_mesh import edges_of

FACING = 0.2  # least cosine between a triangle's normals before and after a collapse
FACING_LAST = -1.0  # the same where nothing else is left to collapse
ROUND_PART = 0.15  # part of the edges, the cheapest, that may collapse in a round
ROUND_PASSES = 6  # choices of edges in a round


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


class Collapsing:
    """A mesh while its edges collapse, and what is known of them.

    No collapse opens, closes, pinches or folds the surface; each part keeps a triangle, or four
    where it is closed. Loose parts go, where that costs less than the next collapses (see
    LooseParts). Of an edge's two points it moves with the nearer.

    corners: (3, m), of the triangles left; stuck: whether nothing may collapse any more.
    """

    def __init__(
        self, mesh: Mesh, quadrics: np.ndarray, normals: np.ndarray, poses: Poses | None = None
    ):
        """Begin with all of a mesh of n points, about of unit size.

        quadrics: (11, n); normals: (n, 3).
        poses: the errors in these add to that at rest. Source: Mohr, Gleicher, "Deformation
            sensitive decimation", 2003.
        """
        # NumPy is several times faster along the long axis
        self.points = mesh.points.T
        self.corners = mesh.triangles.T
        self.quadrics = quadrics
        self.normals = normals.T
        self.poses = poses
        self.follows = np.arange(len(mesh.points))
        self.collapse_map = np.arange(len(mesh.points))
        self._drop_loose()
        copies = 1 + (len(poses.skin.place) if poses else 0)
        self.loose = LooseParts(copies, self.points, self.corners, self.quadrics[10])
        self.facing = FACING
        self._forget()

    def copy(self) -> "Collapsing":
        """Return the same mesh, to collapse further, without the points that are gone."""
        other = copy(self)
        other.loose = self.loose.of(other._drop_loose())
        other._forget()
        return other

    def _drop_loose(self) -> np.ndarray:
        """Drop the points that no triangle has; return those left, (k,), as they were numbered."""
        used, corners = np.unique(self.corners, return_inverse=True)
        numbers = np.full(self.points.shape[1] + 1, -1)  # the last is that of points gone before
        numbers[used] = np.arange(len(used))
        self.corners = np.ascontiguousarray(corners.reshape(3, -1))
        self.points = self.points.take(used, 1)
        self.quadrics = self.quadrics.take(used, 1)
        self.normals = self.normals.take(used, 1)
        self.poses = self.poses and Poses(
            self.poses.skin, [rows.take(used, 1) for rows in self.poses.quadrics]
        )
        self.follows = self.follows[used]
        self.collapse_map = numbers[self.collapse_map]
        return used

    def _forget(self) -> None:
        """Forget what rounds have found of edges."""
        self.stuck = False
        # Where none of the cheapest edges may collapse, all are tried, then also those that turn
        # faces further: `facing` is the least cosine.
        self.thorough = False
        self.refused = np.zeros(0, np.intp)  # keys of edges that must not collapse as things are
        # Of the last round's edges, by key: where each collapses to (3 rows), its cost at rest, and
        # its error in the poses, NaN where it was not needed.
        self.keys = np.zeros(0, np.intp)
        self.estimates = np.zeros((5, 0))
        self.changed = np.zeros(self.points.shape[1], bool)  # points, since then

    @property
    def triangles(self) -> int:
        """How many triangles are left."""
        return self.corners.shape[1]

    def down_to(self, target: int, until: int = 0) -> Iterator[None]:
        """Collapse edges until at most `target` triangles are left, or as few as may be.

        until: stops on the way there, once there are no more than these. So a mesh that goes on
            from there takes the rounds that it would have taken without the stop.

        Yields between the rounds.
        """
        while (excess := self.triangles - target) > 0 and self.triangles > until:
            ends, at = self.next_collapses(excess)
            if ends.shape[1]:
                self.carry_out(ends, at)
                yield
            elif self.stuck:
                break

    def result(self) -> Collapsed:
        """Return the mesh as it is now."""
        left = self.copy()
        return Collapsed(left.points.T, left.corners.T, left.collapse_map, left.follows)

    def next_collapses(self, excess: int) -> tuple[np.ndarray, np.ndarray]:
        """Choose the cheapest edges that may collapse together.

        excess: how many triangles are too many. Returns their ends (2, k), and where they collapse
        to (3, k). k is 0 if loose parts have been given up instead, if the next call is to try
        other edges, or if `stuck`.
        """
        edges = self._estimate_edges()
        cost, order = self._rank_edges(edges)
        dearest = cost[order[: excess // 2 + 1]].max(initial=0)
        nothing = edges.ends[:, :0], edges.at[:, :0]
        if self.loose.cheapest <= dearest:
            self.corners = self.loose.give_up(self.corners, dearest, excess)
            return nothing
        passes = len(order) if self.thorough else ROUND_PASSES
        mesh = CollapsingMesh(self.points, self.corners, self.normals)
        good, bad = choose_collapses(mesh, edges.ends, edges.take(order), passes, self.facing)
        self.refused = np.append(self.refused, self.keys[order[bad]])
        if not len(good):
            self._try_harder(excess)
            return nothing
        candidates = edges.take(order[good])
        candidates = candidates.take(
            slice(np.searchsorted(np.cumsum(candidates.faces), excess) + 1)
        )
        if self.loose.cheapest < np.inf:
            candidates = self._spare_thin_ends(candidates, excess)
        return candidates.ends, candidates.at

    def _estimate_edges(self) -> Edges:
        """Find the edges there are, and where those that are new or have changed collapse to."""
        before = self.keys
        self.keys, ends, faces = edges_of(self.corners, self.points.shape[1])
        self.estimates = take_over_estimates(
            before, self.estimates, self.keys, self.changed[ends].any(axis=0)
        )
        new = np.flatnonzero(np.isnan(self.estimates[3]))
        self.estimates[:3, new], self.estimates[3, new] = place_collapses(
            self.points, self.quadrics, *ends.take(new, 1)
        )
        return Edges(ends, faces, self.estimates[:3])

    def _rank_edges(self, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
        """Return what each edge's collapse costs (k,), and the cheapest edges, in order."""
        barred = are_bridges(edges.ends, edges.faces, self.points.shape[1])
        barred |= np.isin(self.keys, self.refused)
        cost = np.where(barred, np.inf, self.estimates[3])
        most = len(cost)
        if not self.thorough:
            most = min(most, max(64, int(ROUND_PART * most)))
        if self.poses:
            errors = PoseErrors(self.poses, self.follows, self.quadrics[10])
            errors.add(cost, self.estimates[4], edges, most)
        return cost, _cheapest(cost, most)

    def _try_harder(self, excess: int) -> None:
        """Go on where no edge may collapse.

        Try all edges, then let faces turn further, then give up loose parts.
        """
        if self.thorough and self.facing == FACING_LAST:
            self.stuck = self.loose.cheapest == np.inf
            if not self.stuck:
                self.corners = self.loose.give_up(self.corners, np.inf, excess)
            return
        if self.thorough:
            self.refused = self.refused[:0]
            self.facing = FACING_LAST
        self.thorough = not self.thorough
        self.changed = np.zeros(self.points.shape[1], bool)

    def _spare_thin_ends(self, edges: Edges, excess: int) -> Edges:
        """Return those of the edges whose collapse costs less than to give up the next loose part.

        The cost is the true one: quadrics do not tell that an end gets shorter. If all cost more,
        the part is given up, and no edge is returned.
        """
        true_cost = self.loose.true_costs(
            self.points, self.corners, edges.ends, edges.at, self.quadrics[10]
        )
        if true_cost.min() > self.loose.cheapest:
            self.corners = self.loose.give_up(self.corners, true_cost.min(), excess)
            return edges.take(slice(0))
        edges = edges.take(true_cost <= self.loose.cheapest)
        self.loose.follow(edges.ends, edges.at)
        return edges

    def carry_out(self, ends: np.ndarray, at: np.ndarray) -> None:
        """Collapse edges that lie apart: ends (2, k), each to its place of `at` (3, k)."""
        n = self.points.shape[1]
        stays, goes = ends
        around = in_ring(self.corners, ends, n)
        self.refused = self.refused[~around[np.stack(np.divmod(self.refused, n))].any(axis=0)]
        self.thorough = False
        self.points[:, stays] = at
        if self.poses:
            self.follows[stays] = self.poses.skin.nearer(at, *self.follows[ends])
        self.changed = np.zeros(n, bool)
        self.changed[stays] = True
        for rows in (self.quadrics, self.normals, *(self.poses.quadrics if self.poses else ())):
            rows[:, stays] += rows[:, goes]
        self.collapse_map, self.corners = _merged(ends, self.collapse_map, self.corners, n)


def _cheapest(cost: np.ndarray, most: int) -> np.ndarray:
    """The `most` edges of least finite `cost` (k,), the cheapest first.

    Those as cheap as the last of them are among them.
    """
    order = np.flatnonzero((cost <= np.partition(cost, most - 1)[most - 1]) & (cost < np.inf))
    return order[np.argsort(cost[order], kind="stable")]


def _merged(
    ends: np.ndarray, collapse_map: np.ndarray, corners: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """(collapse_map, corners (3, j)) once each edge's second end has become its first.

    ends: (2, k), of the edges; collapse_map: of n points, or -1;
    corners: (3, m); triangles that become flat are dropped.
    """
    move = np.append(np.arange(n), -1)  # the last is that of points gone
    move[ends[1]] = ends[0]
    corners = move[corners]
    return move[collapse_map], corners.compress(~are_flat(corners), axis=1)


def take_over_estimates(
    before: np.ndarray, estimates: np.ndarray, keys: np.ndarray, changed: np.ndarray
) -> np.ndarray:
    """The estimates of the round before, for the edges of this round.

    before: (j,) keys of that round's edges, in order; estimates: (r, j). keys: (k,) of this round's
    edges, in order; changed: (k,) bool. Returns (r, k): NaN for edges that are new or changed.
    """
    result = np.full((len(estimates), len(keys)), np.nan)
    if len(before):
        at = np.minimum(np.searchsorted(before, keys), len(before) - 1)
        same = np.flatnonzero((before[at] == keys) & ~changed)
        result[:, same] = estimates.take(at[same], 1)
    return result
