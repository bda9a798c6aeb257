"""The Hausdorff distance of two moving surfaces, over all poses: an interval, and an estimate.

Each triangle of one surface is mapped onto the other, linearly on each of a few pieces. A piece's
largest distance from its image is at a corner, and the other surface is no farther off than the
image. The map is found in one pose and holds in all: there only its corners are measured. Where
that says too much it is found anew in that pose, and pieces are divided. Sources:
Guthe, Borodin, Klein, "Fast and accurate Hausdorff distance calculation between meshes", 2005;
Sacht, Jacobson, "Cascading upper bounds for triangle soup Pompeiu-Hausdorff distance", 2024.

An estimate looks at some places of either surface, point by point.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..progress import check_cancelled
from .moving_surface import (
    MovingSurface,
    Target,
    faces_beneath,
    length_of,
    map_to_neighbors,
    map_to_one,
    mixed,
    piece_distances,
)
from .triangle_mesh import blocks, edges_of

TOLERANCE = 0.03  # the bound is larger by this part than what was measured
FLOOR = 5e-5  # of the size: no bound need be lower
DEPTH = 10  # times that pieces are divided, at most
PIECES = 400_000  # of one surface in a pose; where there would be more, the bound is left as it is
FIRST = 8  # points of each pose that are measured first, those which may be farthest off

TOGETHER = 4_000  # points, or pieces, in all poses that fit in the processor's cache
HOPELESS = 2.0  # times the distance asked for, of which it does not matter how much more it is
ALONG = (0.25, 0.5, 0.75)  # parts of an edge where points lie
# Where a place is far off, more are looked at: from a triangle's middle towards its edges, and on
# either side along an edge. These are steps of barycentric weights.
TO_EDGES = np.array([(-2, 1, 1), (1, -2, 1), (1, 1, -2)]) / 12
BESIDE = np.array([(1, -1, 0), (-1, 1, 0), (0, 0, 0)]) / 8


@dataclass
class Interval:
    """What is known of the distance over all poses, meters.

    It is at least `measured`, as at `place`, (3,) meters, in `pose`, and at most `bound`. floor: a
    bound need not be lower.
    """

    floor: float
    measured: float = 0.0
    pose: int = 0
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bound: float = 0.0

    def see(self, distance: np.ndarray, pose: int, at: np.ndarray) -> None:
        """Note distances (n,) from points `at` (n, 3), in the pose."""
        most = float(distance.max(initial=0.0))
        if most > self.measured:
            self.measured = most
            self.pose = pose
            self.place = at[distance.argmax()]

    @property
    def enough(self) -> float:
        return max((1 + TOLERANCE) * self.measured, self.floor)


@dataclass
class MappedPoints:
    """Points of one surface, mapped to the other.

    at: (n, poses, 3); to: (n,), triangles; weights: (n, 3), barycentric, on these; off: (n, poses)
    meters from there.
    near: (n, poses), meters: each is no farther from the other surface.
    """

    at: np.ndarray
    to: np.ndarray
    weights: np.ndarray
    off: np.ndarray
    near: np.ndarray

    def join(self, more: "MappedPoints") -> "MappedPoints":
        pairs = zip(vars(self).values(), vars(more).values(), strict=True)
        return MappedPoints(*map(np.concatenate, pairs))


def bound_distance(surface: MovingSurface, other: MovingSurface, least: float = 0.0) -> Interval:
    """The symmetric Hausdorff distance of two surfaces, the largest over their poses.

    Of each surface those pieces are measured that count (MovingSurface.pieces), against the whole
    of the other. least: meters, a bound need not be lower.
    """
    interval = begin_interval(surface)
    interval.floor = max(interval.floor, least)
    poses = slice(0, surface.points.shape[1])
    surfaces = (surface, other)
    ways = [DistanceTo(Target(target, poses), interval) for target in (other, surface)]
    numbered = [np.unique(side.pieces, return_inverse=True) for side in surfaces]
    mapped = [
        way.map_points(side.points[points])
        for way, side, (points, _) in zip(ways, surfaces, numbered, strict=True)
    ]
    for way, points in zip(ways, mapped, strict=True):
        way.look_again(points)
    for way, points, side, (_, pieces) in zip(ways, mapped, surfaces, numbered, strict=True):
        corners = side.points[side.pieces]
        longest = length_of(corners - corners[:, [1, 2, 0]]).max(axis=1)
        way.cover(points, pieces.reshape(-1, 3), longest)
    interval.bound = max(interval.bound, interval.enough)
    return interval


def begin_interval(surface: MovingSurface) -> Interval:
    """Return an Interval of which nothing is known yet."""
    return Interval(FLOOR * float(np.ptp(surface.points, axis=0).max()))


@dataclass
class DistanceTo:
    """The distance of points and pieces of a surface from a target; `interval` notes what is found.

    The poses are those of the target.
    """

    target: Target
    interval: Interval

    def map_points(self, at: np.ndarray, to: np.ndarray | None = None) -> MappedPoints:
        """Points (n, poses, 3), mapped to the nearest in the first pose.

        to: (n,) the target's triangles nearest to them there; sought if None.
        """
        target = self.target
        if to is None:
            to = target.surface.find(target.base, at[:, 0])
        weights = target.on(to, at[:, 0])
        off = np.empty(at.shape[:2])
        for block in blocks(len(at), TOGETHER):
            check_cancelled()
            corners = target.surface.triangles[to[block]]
            off[block] = length_of(at[block] - target.mix(corners, weights[block], target.poses))
        self.interval.see(off[:, 0], target.base, at[:, 0])
        return MappedPoints(at, to, weights, off, off.copy())

    def look_again(self, points: MappedPoints, beyond: float = np.inf) -> None:
        """Measure points in the poses where they may be farther off than any, or than `beyond`.

        What is nearest to a point in one pose is held against it in all others: a point seldom
        needs a search in more than two.
        """
        for most in (FIRST, None):
            for k in range(1, points.off.shape[1]):
                far = np.flatnonzero(points.near[:, k] > min(self.interval.enough, beyond))
                if most is not None and len(far) > most:
                    far = far[np.argpartition(-points.near[far, k], most)[:most]]
                for block in blocks(len(far), TOGETHER):
                    check_cancelled()
                    self._search_again(points, k, far[block])

    def _search_again(self, points: MappedPoints, k: int, far: np.ndarray) -> None:
        """Find what is nearest to the points `far` (s,) in the k-th pose, and measure it in all."""
        at = points.at[far]
        again = self.alone(k).map_points(at[:, k, None])
        corners = self.target.surface.triangles[again.to]
        image = self.target.mix(corners, again.weights, self.target.poses)
        points.near[far] = np.minimum(points.near[far], length_of(at - image))
        points.near[far, k] = again.off[:, 0]

    def alone(self, k: int) -> "DistanceTo":
        """The same in the k-th of the poses alone."""
        pose = self.target.base + k
        return DistanceTo(Target(self.target.surface, slice(pose, pose + 1)), self.interval)

    def cover(self, points: MappedPoints, pieces: np.ndarray, longest: np.ndarray) -> None:
        """Bound the distance of pieces, triangles of mapped points.

        pieces: (p, 3); longest: (p, poses), meters: none of their edges is longer.
        """
        later = []
        for depth in range(DEPTH + 1):
            near = points.near[pieces]
            most = np.minimum(near.min(axis=1) + longest, near.max(axis=1) + longest / np.sqrt(3))
            far = np.flatnonzero((most > self.interval.enough).any(axis=1))
            most = np.minimum(most[far], self._map_pieces(points, pieces[far]))
            wrong = most > self.interval.enough
            split = wrong[:, 0]
            if depth == DEPTH or 4 * split.sum() > PIECES:
                self.interval.bound = max(self.interval.bound, float(most[split, 0].max(initial=0)))
                split = np.zeros_like(split)
            in_others = np.flatnonzero(wrong.any(axis=1) & ~split)
            later.append((pieces[far[in_others]], longest[far[in_others]], wrong[in_others]))
            far = far[split]
            if not len(far):
                break
            points, pieces = self._divide(points, pieces[far])
            longest = np.tile(longest[far] / 2, (4, 1))
        for k in range(1, longest.shape[1]):
            corners = np.concatenate([pieces[wrong[:, k]] for pieces, _, wrong in later])
            sides = np.concatenate([longest[wrong[:, k], k] for _, longest, wrong in later])
            if len(corners):
                self._cover_in_pose(k, points, corners, sides)

    def _cover_in_pose(
        self, k: int, points: MappedPoints, pieces: np.ndarray, longest: np.ndarray
    ) -> None:
        """Bound the distance of pieces in the k-th pose, by a map that is found there.

        pieces: (p, 3), of points; longest: (p,), meters: none of their edges is longer.
        """
        used, corners = np.unique(pieces, return_inverse=True)
        way = self.alone(k)
        mapped = way.map_points(points.at[used, k, None])
        way.cover(mapped, corners.reshape(-1, 3), longest[:, None])

    def _divide(self, points: MappedPoints, pieces: np.ndarray) -> tuple[MappedPoints, np.ndarray]:
        """Divide pieces into four: the points with those between, and (4 p, 3) pieces."""
        n = len(points.at)
        low, high = np.sort(np.stack([pieces, pieces[:, [1, 2, 0]]]), axis=0)
        keys, middle = np.unique(low * n + high, return_inverse=True)
        points = points.join(self.map_points((points.at[keys // n] + points.at[keys % n]) / 2))
        a, b, c = pieces.T
        ab, bc, ca = n + middle.reshape(-1, 3).T
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        return points, np.concatenate([np.stack(corners, axis=1) for corners in quarters])

    def _map_pieces(self, points: MappedPoints, pieces: np.ndarray) -> np.ndarray:
        """The meters (p, poses) that pieces are off at most, mapped to faces.

        To one triangle, or to neighbors; infinite where that is too much in the first pose already.
        """
        to = points.to[pieces]
        on_one = (to == to[:, :1]).all(axis=1)
        most = np.where(on_one[:, None], points.off[pieces].max(axis=1), np.inf)
        far = np.flatnonzero((most > self.interval.enough).any(axis=1))
        for block in blocks(len(far), TOGETHER):
            check_cancelled()
            self._map_far_pieces(points, pieces, far[block], most)
        return most

    def _map_far_pieces(
        self, points: MappedPoints, pieces: np.ndarray, far: np.ndarray, most: np.ndarray
    ) -> None:
        """Map the pieces `far` (s,) to neighbors, those still too far off to one triangle.

        most: (p, poses), of all pieces (p, 3): takes up how far these are off at most.
        """
        target = self.target
        far_pieces = pieces[far]
        corners = points.at.take(far_pieces, 0)
        beneath = faces_beneath(
            target, corners[:, :, 0], points.to[far_pieces], points.weights[far_pieces]
        )
        for map_to in (map_to_neighbors, map_to_one):
            pairs = map_to(target, corners[:, :, 0], beneath)
            in_base = piece_distances(target, pairs, corners[:, :, :1], target.base_alone)
            good = in_base[:, 0] <= self.interval.enough
            most[far[good]] = piece_distances(target, pairs.of(good), corners[good], target.poses)
            still = (most[far] > self.interval.enough).any(axis=1)
            far = far[still]
            corners = corners[still]
            beneath = beneath[still]
            if not len(far):
                break


@dataclass
class SurfacePoints:
    """Points of a surface: corners of its triangles, and points between them.

    corners: (s, 3) indices of points; weights: (s, 3), barycentric.
    """

    corners: np.ndarray
    weights: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return where they are, (s, ..., 3) meters, of the surface's points (n, ..., 3)."""
        return mixed(points, self.corners, self.weights)

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
