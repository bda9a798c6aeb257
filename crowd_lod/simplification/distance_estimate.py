"""Estimates of the distance of two moving surfaces: at some places of either, point by point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .hausdorff import DistanceTo, MappedPoints, begin_interval
from .moving_surface import MovingSurface, Target
from .triangle_mesh import edges_of

HOPELESS = 2.0  # times the distance asked for, of which it does not matter how much more it is
ALONG = (0.25, 0.5, 0.75)  # parts of an edge where points lie
# Where a place is far off, more are looked at: from a triangle's middle towards its edges, and on
# either side along an edge. These are steps of barycentric weights.
TO_EDGES = np.array([(-2, 1, 1), (1, -2, 1), (1, 1, -2)]) / 12
BESIDE = np.array([(1, -1, 0), (-1, 1, 0), (0, 0, 0)]) / 8


@dataclass
class SurfacePoints:
    """Points of a surface: corners of its triangles, and points between them.

    corners: (s, 3) indices of points; weights: (s, 3), barycentric.
    """

    corners: np.ndarray
    weights: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return where they are, (s, ..., 3) meters, of the surface's points (n, ..., 3)."""
        weights = self.weights.reshape(*self.weights.shape, *[1] * (points.ndim - 1))
        return sum(weights[:, c] * points[self.corners[:, c]] for c in range(3))

    def of(self, which: np.ndarray) -> "SurfacePoints":
        """Return some of them."""
        return SurfacePoints(self.corners[which], self.weights[which])


def places_on(triangles: np.ndarray, large: np.ndarray) -> SurfacePoints:
    """Return the corners of triangles, and of the large ones the middles and points on the edges.

    A LOD is often farthest off where an edge of it runs across a crease.

    triangles, large: (m, 3) and (k, 3) indices of points.
    """
    points = np.unique(triangles)
    _, ends, _ = edges_of(large.T, large.max(initial=0) + 1)
    corners = [points[:, None].repeat(3, axis=1), large, *[ends[[0, 1, 1]].T] * len(ALONG)]
    weights = [(1, 0, 0), (1 / 3, 1 / 3, 1 / 3), *((1 - part, part, 0) for part in ALONG)]
    counts = [len(rows) for rows in corners]
    weights_of_all = np.repeat(np.array(weights, np.float64), counts, axis=0)
    return SurfacePoints(np.concatenate(corners), weights_of_all)


def estimate_distances(
    surface: MovingSurface,
    other: MovingSurface,
    parts: Sequence[tuple[SurfacePoints, SurfacePoints]],
    beyond: float,
) -> tuple[list[float], np.ndarray]:
    """Estimate what `bound_distance` measures, part by part and point by point.

    parts: of each, such as an object, the points of `surface` and those of `other`, whose distances
        from the whole of the other surface count. Those of a triangle of `other` count where what
        is nearest of `surface` to one of its corners counts.

    Returns the distance of each part, and that of each point of `surface`, (n,) meters: the largest
    of places nearest to it, of either surface. Of a point that is no farther off than `beyond` this
    may be too much. A part that is HOPELESS in the first pose is not looked at in the others.
    """
    poses = slice(0, surface.points.shape[1])
    away = np.zeros(len(surface.points))
    distances = []
    for places, other_places in parts:
        interval = begin_interval(surface)
        there = DistanceTo(Target(other, poses), interval)
        back = DistanceTo(Target(surface, poses), interval)
        points = there.map_points(places.at(surface.points))
        other_points = _map_counted(back, other_places, other, beyond)
        if interval.measured <= HOPELESS * beyond:
            there.look_again(points, beyond)
            back.look_again(other_points, beyond)
        nearest = _nearest_corner(places.corners, places.weights)
        np.maximum.at(away, nearest, points.near.max(axis=1))
        nearest = _nearest_corner(surface.triangles[other_points.to], other_points.weights)
        np.maximum.at(away, nearest, other_points.near.max(axis=1))
        distances.append(interval.measured)
    return distances, away


def _map_counted(
    way: DistanceTo, places: SurfacePoints, surface: MovingSurface, beyond: float
) -> MappedPoints:
    """Map those points of a LOD's surface that count, and more of them along edges far off.

    Those of a triangle count if what is nearest to one of its corners does.
    """
    at = places.at(surface.points)
    to = way.target.surface.find(way.target.base, at[:, 0])
    counted = way.target.surface.counted
    if counted is not None:
        visible = np.zeros(len(surface.points), bool)
        corner = np.flatnonzero(places.weights[:, 0] == 1)
        visible[places.corners[corner, 0]] = counted[to[corner]]
        count = visible[places.corners].any(axis=1)
        places = places.of(count)
        at = at[count]
        to = to[count]
    points = way.map_points(at, to)
    far = places.of((points.near.max(axis=1) > beyond / 2) & (places.weights[:, 0] < 1))
    if not len(far.corners):
        return points
    middle = far.weights[:, 2] > 0
    steps = [np.where(middle[:, None], *pair) for pair in zip(TO_EDGES, BESIDE, strict=True)]
    finer = SurfacePoints(
        np.tile(far.corners, (len(steps), 1)),
        np.concatenate([far.weights + step for step in steps]),
    )
    return points.join(way.map_points(finer.at(surface.points)))


def _nearest_corner(corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the one of corners (s, 3) with the largest of weights (s, 3), (s,)."""
    return np.take_along_axis(corners, weights.argmax(axis=1)[:, None], axis=1)[:, 0]


def upper_distances(
    surface: MovingSurface, other: MovingSurface, places: SurfacePoints
) -> np.ndarray:
    """Return how far points of `surface` are from `other` at most, in any pose, (s,) meters."""
    poses = slice(0, surface.points.shape[1])
    way = DistanceTo(Target(other, poses), begin_interval(surface))
    return way.map_points(places.at(surface.points)).near.max(axis=1)
