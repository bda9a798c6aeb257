"""An interval of the Hausdorff distance of two moving surfaces, over all poses.

Each triangle of one surface is mapped onto the other, linearly on each of a few pieces. A piece's
largest distance from its image is at a corner, and the other surface is no farther off than the
image. The map is found in one pose and holds in all:
there only its corners are measured. Where that says too much it is found anew in that pose, and
pieces are divided. Sources:
Guthe, Borodin, Klein, "Fast and accurate Hausdorff distance calculation between meshes", 2005;
Sacht, Jacobson, "Cascading upper bounds for triangle soup Pompeiu-Hausdorff distance", 2024.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from . import settings
from .closest_point import closest_weights, walk
from .triangle_mesh import TriangleMesh, blocks, edges_of, normals

TOGETHER = 4_000  # points, or pieces, in all poses that fit in the processor's cache
HOPELESS = 2.0  # times the distance asked for, of which it does not matter how much more it is
ALONG = (0.25, 0.5, 0.75)  # parts of an edge where Places lie
# Where a place is far off, more are looked at: from a triangle's middle towards its edges, and on
# either side along an edge. These are steps of barycentric weights.
TO_EDGES = np.array([(-2, 1, 1), (1, -2, 1), (1, 1, -2)]) / 12
BESIDE = np.array([(1, -1, 0), (-1, 1, 0), (0, 0, 0)]) / 8


@dataclass
class Moving:
    """A surface in k poses.

    points: (n, k, 3) float64 meters; triangles: (m, 3) indices.
    find(pose, points (j, 3)): the triangles (j,) closest to the points in that pose.
    counted: (m,) bool, the triangles whose distance from another surface counts; None if all do.
    """

    points: np.ndarray
    triangles: np.ndarray
    find: Callable[[int, np.ndarray], np.ndarray]
    counted: np.ndarray | None = None

    @property
    def pieces(self) -> np.ndarray:
        """The triangles (p, 3) whose distance counts."""
        return self.triangles if self.counted is None else self.triangles[self.counted]

    def on(self, face: np.ndarray, points: np.ndarray, pose: int) -> np.ndarray:
        """Barycentric weights (j, 3) of the points of faces closest to `points` (j, 3).

        face: (j,); in the given pose.
        """
        return closest_weights(points.T, *self.corners(face, pose)).T

    def corners(self, face: np.ndarray, pose: int) -> list[np.ndarray]:
        """The corners of the triangles `face` (j,) in the pose, three times (3, j)."""
        return [self.points[self.triangles[face, c], pose].T for c in range(3)]

    def mesh(self, pose: int) -> TriangleMesh:
        """The surface in the pose."""
        return self.rest.moved(np.ascontiguousarray(self.points[:, pose].T))

    @cached_property
    def rest(self) -> TriangleMesh:
        """The surface in the first pose."""
        return TriangleMesh(self.points[:, 0].T, np.ascontiguousarray(self.triangles.T))


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
        return max((1 + settings.CURRENT.bound_tolerance) * self.measured, self.floor)


@dataclass
class _Points:
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

    def joined(self, more: "_Points") -> "_Points":
        return _Points(
            *(
                np.concatenate(pair)
                for pair in zip(vars(self).values(), vars(more).values(), strict=True)
            )
        )


@dataclass
class _Pairs:
    """Points of pieces, and the points of the other surface that they map to.

    piece: (q,); weights: (q, 3), barycentric, on the piece; to: (q, 3), points of the other
    surface; to_weights: (q, 3), NaN where there is no map.
    """

    piece: np.ndarray
    weights: np.ndarray
    to: np.ndarray
    to_weights: np.ndarray

    def of(self, pieces: np.ndarray) -> "_Pairs":
        """Those of the pieces (p,) bool alone, which are numbered anew."""
        some = np.flatnonzero(pieces[self.piece])
        return _Pairs(
            (np.cumsum(pieces) - 1)[self.piece[some]],
            self.weights[some],
            self.to[some],
            self.to_weights[some],
        )


def interval(one: Moving, other: Moving, least: float = 0.0) -> Interval:
    """The symmetric Hausdorff distance of two surfaces, the largest over their poses.

    It is that of what counts of either from the whole of the other. least: meters, a bound need not
    be lower.
    """
    found = _nothing_known(one)
    found.floor = max(found.floor, least)
    ways = [_Way(b, found, slice(0, b.points.shape[1])) for b in (other, one)]
    used = [np.unique(a.pieces, return_inverse=True) for a in (one, other)]
    mapped = [
        way.mapped(a.points[some])
        for way, a, (some, _) in zip(ways, (one, other), used, strict=True)
    ]
    for way, points in zip(ways, mapped, strict=True):
        way.look_again(points)
    for way, points, a, (_, pieces) in zip(ways, mapped, (one, other), used, strict=True):
        corners = a.points[a.pieces]
        longest = _length(corners - corners[:, [1, 2, 0]]).max(axis=1)
        way.cover(points, pieces.reshape(-1, 3), longest)
    found.bound = max(found.bound, found.enough)
    return found


@dataclass
class Places:
    """Points of a surface: corners of its triangles, and points between them.

    corners: (s, 3) indices of points; weights: (s, 3), barycentric.
    """

    corners: np.ndarray
    weights: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return where they are, (s, ..., 3) meters, of the surface's points (n, ..., 3)."""
        weights = self.weights.reshape(*self.weights.shape, *[1] * (points.ndim - 1))
        return sum(weights[:, c] * points[self.corners[:, c]] for c in range(3))

    def of(self, some: np.ndarray) -> "Places":
        """Return some of them."""
        return Places(self.corners[some], self.weights[some])


def places_on(triangles: np.ndarray, large: np.ndarray) -> Places:
    """Return the corners of triangles, and of the large ones the middles and points on the edges.

    A LOD is often farthest off where an edge of it runs across a crease.

    triangles, large: (m, 3) and (k, 3) indices of points.
    """
    points = np.unique(triangles)
    _, ends, _ = edges_of(large.T, large.max(initial=0) + 1)
    corners = [points[:, None].repeat(3, axis=1), large, *[ends[[0, 1, 1]].T] * len(ALONG)]
    weights = [(1, 0, 0), (1 / 3, 1 / 3, 1 / 3), *((1 - part, part, 0) for part in ALONG)]
    return Places(
        np.concatenate(corners),
        np.repeat(np.array(weights, np.float64), [len(each) for each in corners], axis=0),
    )


def estimate(
    one: Moving, other: Moving, parts: Sequence[tuple[Places, Places]], beyond: float
) -> tuple[list[float], np.ndarray]:
    """Estimate what `interval` measures, part by part and point by point.

    parts: of each, such as an object, the Places of `one` and those of `other`, whose distances
        from the whole of the other surface count. Those of a triangle of `other` count where what
        is nearest of `one` to one of its corners counts.

    Returns the distance of each part, and that of each point of `one`, (n,) meters: the largest of
    places nearest to it, of either surface. Of a point that is no farther off than `beyond` this
    may be too much. A part that is HOPELESS in the first pose is not looked at in the others.
    """
    every = slice(0, one.points.shape[1])
    away = np.zeros(len(one.points))
    distances = []
    for mine, theirs in parts:
        found = _nothing_known(one)
        there = _Way(other, found, every)
        back = _Way(one, found, every)
        points = there.mapped(mine.at(one.points))
        others = _map_counted(back, theirs, other, beyond)
        if found.measured <= HOPELESS * beyond:
            there.look_again(points, beyond)
            back.look_again(others, beyond)
        nearest = _nearest_corner(mine.corners, mine.weights)
        np.maximum.at(away, nearest, points.near.max(axis=1))
        nearest = _nearest_corner(one.triangles[others.to], others.weights)
        np.maximum.at(away, nearest, others.near.max(axis=1))
        distances.append(found.measured)
    return distances, away


def _map_counted(way: "_Way", places: Places, surface: Moving, beyond: float) -> "_Points":
    """Map those Places of a LOD's surface that count, and more of them along edges far off.

    Those of a triangle count if what is nearest to one of its corners does.
    """
    at = places.at(surface.points)
    to = way.other.find(way.base, at[:, 0])
    if way.other.counted is not None:
        visible = np.zeros(len(surface.points), bool)
        corner = np.flatnonzero(places.weights[:, 0] == 1)
        visible[places.corners[corner, 0]] = way.other.counted[to[corner]]
        count = visible[places.corners].any(axis=1)
        places = places.of(count)
        at = at[count]
        to = to[count]
    points = way.mapped(at, to)
    far = places.of((points.near.max(axis=1) > beyond / 2) & (places.weights[:, 0] < 1))
    if not len(far.corners):
        return points
    middle = far.weights[:, 2] > 0
    steps = [np.where(middle[:, None], *each) for each in zip(TO_EDGES, BESIDE, strict=True)]
    finer = Places(
        np.tile(far.corners, (len(steps), 1)),
        np.concatenate([far.weights + step for step in steps]),
    )
    return points.joined(way.mapped(finer.at(surface.points)))


def _nearest_corner(corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the one of corners (s, 3) with the largest of weights (s, 3), (s,)."""
    return np.take_along_axis(corners, weights.argmax(axis=1)[:, None], axis=1)[:, 0]


def upper_distances(one: Moving, other: Moving, places: Places) -> np.ndarray:
    """Return how far Places of `one` are from `other` at most, in any pose, (s,) meters."""
    way = _Way(other, _nothing_known(one), slice(0, one.points.shape[1]))
    return way.mapped(places.at(one.points)).near.max(axis=1)


def _nothing_known(one: Moving) -> Interval:
    return Interval(settings.CURRENT.bound_floor * float(np.ptp(one.points, axis=0).max()))


@dataclass
class _Way:
    """The distance from one surface to `other`, in the given poses.

    The map is found in the first of the poses; `found` takes up what is found.
    """

    other: Moving
    found: Interval
    poses: slice

    @property
    def base(self) -> int:
        return self.poses.start

    @cached_property
    def mesh(self) -> TriangleMesh:
        return self.other.mesh(self.base)

    def mapped(self, at: np.ndarray, to: np.ndarray | None = None) -> _Points:
        """Points (n, poses, 3), mapped to the nearest in the first pose.

        to: (n,) the triangles of `other` nearest to them there; sought if None.
        """
        to = self.other.find(self.base, at[:, 0]) if to is None else to
        weights = self.other.on(to, at[:, 0], self.base)
        off = np.empty(at.shape[:2])
        for some in blocks(len(at), TOGETHER):
            off[some] = _length(
                at[some] - self.mixed(self.other.triangles[to[some]], weights[some], self.poses)
            )
        self.found.see(off[:, 0], self.base, at[:, 0])
        return _Points(at, to, weights, off, off.copy())

    def mixed(self, corners: np.ndarray, weights: np.ndarray, poses: slice) -> np.ndarray:
        """The points (j, poses, 3) at weights (j, 3) of points (j, 3) of `other`."""
        return sum(
            self.other.points[corners[:, c], poses] * weights[:, c, None, None] for c in range(3)
        )

    def look_again(self, points: _Points, beyond: float = np.inf) -> None:
        """Measure points in the poses where they may be farther off than any, or than `beyond`.

        What is nearest to a point in one pose is held against it in all others: a point seldom
        needs a search in more than two.
        """
        for most in (settings.CURRENT.bound_first, None):
            for k in range(1, points.off.shape[1]):
                some = np.flatnonzero(points.near[:, k] > min(self.found.enough, beyond))
                if most is not None and len(some) > most:
                    some = some[np.argpartition(-points.near[some, k], most)[:most]]
                for block in blocks(len(some), TOGETHER):
                    self._search_again(points, k, some[block])

    def _search_again(self, points: _Points, k: int, some: np.ndarray) -> None:
        """Find what is nearest to some points (s,) in the k-th pose, and how far that is off in
        all.
        """
        at = points.at[some]
        again = self.alone(k).mapped(at[:, k, None])
        image = self.mixed(self.other.triangles[again.to], again.weights, self.poses)
        points.near[some] = np.minimum(points.near[some], _length(at - image))
        points.near[some, k] = again.off[:, 0]

    def alone(self, k: int) -> "_Way":
        """The same in the k-th of the poses alone."""
        return _Way(self.other, self.found, slice(self.base + k, self.base + k + 1))

    def cover(self, points: _Points, pieces: np.ndarray, longest: np.ndarray) -> None:
        """Bound the distance of pieces, triangles of mapped points.

        pieces: (p, 3); longest: (p, poses), meters: none of their edges is longer.
        """
        later = []
        for depth in range(settings.CURRENT.bound_depth + 1):
            near = points.near[pieces]
            most = np.minimum(near.min(axis=1) + longest, near.max(axis=1) + longest / np.sqrt(3))
            some = np.flatnonzero((most > self.found.enough).any(axis=1))
            most = np.minimum(most[some], self.mapped_pieces(points, pieces[some]))
            wrong = most > self.found.enough
            split = wrong[:, 0]
            if (
                depth == settings.CURRENT.bound_depth
                or 4 * split.sum() > settings.CURRENT.bound_pieces
            ):
                self.found.bound = max(self.found.bound, float(most[split, 0].max(initial=0)))
                split = np.zeros_like(split)
            rest = np.flatnonzero(wrong.any(axis=1) & ~split)
            later.append((pieces[some[rest]], longest[some[rest]], wrong[rest]))
            some = some[split]
            if not len(some):
                break
            points, pieces = self.divided(points, pieces[some])
            longest = np.tile(longest[some] / 2, (4, 1))
        for k in range(1, longest.shape[1]):
            some = np.concatenate([each[wrong[:, k]] for each, _, wrong in later])
            sides = np.concatenate([each[wrong[:, k], k] for _, each, wrong in later])
            if len(some):
                used, corners = np.unique(some, return_inverse=True)
                way = self.alone(k)
                way.cover(
                    way.mapped(points.at[used, k, None]), corners.reshape(-1, 3), sides[:, None]
                )

    def divided(self, points: _Points, pieces: np.ndarray) -> tuple[_Points, np.ndarray]:
        """Divide pieces into four: the points with those between, and (4 p, 3) pieces."""
        n = len(points.at)
        low, high = np.sort(np.stack([pieces, pieces[:, [1, 2, 0]]]), axis=0)
        keys, middle = np.unique(low * n + high, return_inverse=True)
        points = points.joined(self.mapped((points.at[keys // n] + points.at[keys % n]) / 2))
        a, b, c = pieces.T
        ab, bc, ca = n + middle.reshape(-1, 3).T
        return points, np.concatenate(
            [
                np.stack(each, axis=1)
                for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            ]
        )

    def mapped_pieces(self, points: _Points, pieces: np.ndarray) -> np.ndarray:
        """The meters (p, poses) that pieces are off at most, mapped to faces.

        To one triangle, or to neighbors; infinite where that is too much in the first pose already.
        """
        to = points.to[pieces]
        most = np.where(
            (to == to[:, :1]).all(axis=1)[:, None], points.off[pieces].max(axis=1), np.inf
        )
        every = np.flatnonzero((most > self.found.enough).any(axis=1))
        for block in blocks(len(every), TOGETHER):
            some = every[block]
            corners = points.at[pieces[some]]
            beneath = self.beneath(points, pieces[some])
            for mapping in (self.to_neighbors, self.to_one):
                pairs = mapping(corners[:, :, 0], beneath)
                first = self.off(pairs, corners[:, :, :1], slice(self.base, self.base + 1))[:, 0]
                good = first <= self.found.enough
                most[some[good]] = self.off(pairs.of(good), corners[good], self.poses)
                still = (most[some] > self.found.enough).any(axis=1)
                some = some[still]
                corners = corners[still]
                beneath = beneath[still]
                if not len(some):
                    break
        return most

    def off(self, pairs: _Pairs, corners: np.ndarray, poses: slice) -> np.ndarray:
        """The meters (p, poses) that pieces are off at most by the pairs.

        corners: (p, 3, poses, 3). Infinite where there is no map.
        """
        at = sum(corners[pairs.piece, c] * pairs.weights[:, c, None, None] for c in range(3))
        off = _length(at - self.mixed(pairs.to, pairs.to_weights, poses))
        order = np.argsort(pairs.piece, kind="stable")
        most = np.maximum.reduceat(
            off[order], np.searchsorted(pairs.piece[order], np.arange(len(corners)))
        )
        return np.where(np.isnan(most), np.inf, most)

    def beneath(self, points: _Points, pieces: np.ndarray) -> np.ndarray:
        """The triangles (p, 3) of `other` beneath the pieces, near each corner."""
        corner = points.at[pieces, 0]
        inside = corner + settings.CURRENT.bound_inside * (
            corner.mean(axis=1, keepdims=True) - corner
        )
        start = self.mesh.corner(points.to[pieces.ravel()], points.weights[pieces.ravel()].T)
        return walk(self.mesh, start, np.ascontiguousarray(inside.reshape(-1, 3).T))[0].reshape(
            -1, 3
        )

    def to_one(self, at: np.ndarray, beneath: np.ndarray) -> _Pairs:
        """Map pieces, with corners (p, 3, 3), to one triangle each.

        Of the triangles (p, 3) beneath its corners, that to which it is nearest.
        """
        on = np.array(
            [[self.other.on(each, at[:, c], self.base) for c in range(3)] for each in beneath.T]
        )
        to = self.other.triangles[beneath]
        first = slice(self.base, self.base + 1)
        off = [
            [_length(at[:, c] - self.mixed(to[:, t], on[t, c], first)[:, 0]) for c in range(3)]
            for t in range(3)
        ]
        best = np.max(off, axis=1).argmin(axis=0)
        every = np.arange(len(at))
        return _joined(
            [
                _Pairs(
                    every,
                    np.broadcast_to(np.eye(3)[c], at.shape[:2]),
                    to[every, best],
                    on[best, c, every],
                )
                for c in range(3)
            ]
        )

    def to_neighbors(self, at: np.ndarray, beneath: np.ndarray) -> _Pairs:
        """Map each corner's part of a piece to the triangle beneath it.

        at: (p, 3, 3) corners; beneath: (p, 3) triangles, which must have a corner in common, the
        hub. Edges of the piece are cut where they cross spokes, the edges that meet in the hub.
        Where they go all round the hub, it is mapped as well.
        """
        to = self.other.triangles[beneath]
        every = np.arange(len(at))
        common = (to[:, 0, :, None, None] == to[:, None, 1:, :]).any(axis=3).all(axis=2)
        hub = to[every, 0, common.argmax(axis=1)]
        pairs = []
        turned = np.zeros(len(at), np.intp)
        for c in range(3):
            weights = np.broadcast_to(np.eye(3)[c], at.shape[:2])
            pairs.append(
                _Pairs(every, weights, to[:, c], self.other.on(beneath[:, c], at[:, c], self.base))
            )
        pairs[0].to_weights[~common.any(axis=1)] = np.nan
        for i, j in ((0, 1), (1, 2), (2, 0)):
            some = np.flatnonzero((beneath[:, i] != beneath[:, j]) & common.any(axis=1))
            for crossing, steps in self.crossings(at, beneath, hub, (i, j), some):
                pairs.append(crossing)
                turned[crossing.piece] += steps
        some = np.flatnonzero(turned)
        weights = closest_weights(
            self.other.points[hub[some], self.base].T, *at[some].transpose(1, 2, 0)
        ).T
        return _joined(
            [
                *pairs,
                _Pairs(
                    some, weights, hub[some, None].repeat(3, axis=1), np.eye(3)[np.zeros_like(some)]
                ),
            ]
        )

    def crossings(
        self,
        at: np.ndarray,
        beneath: np.ndarray,
        hub: np.ndarray,
        side: tuple[int, int],
        some: np.ndarray,
    ) -> Iterator[tuple[_Pairs, np.ndarray]]:
        """The spokes that an edge of the pieces `some` crosses, one after another.

        side: the edge's two corners. Yields _Pairs where it crosses, and 1 or -1 for each: the way
        round the hub.
        """
        i, j = side
        face = beneath[some, i]
        last = beneath[some, j]
        middle = self.other.points[hub[some], self.base]
        one = at[some, i]
        other = at[some, j]
        up = np.add(*(normals(*self.other.corners(each, self.base)) for each in (face, last))).T
        left = np.einsum("pd,pd->p", np.cross(one - middle, other - middle), up) > 0
        for more in reversed(range(settings.CURRENT.bound_spokes)):
            place = (self.other.triangles[face] == hub[some, None]).argmax(axis=1)
            rim = self.other.triangles[face, (place + 1 + left) % 3]
            end = self.other.points[rim, self.base]
            across = np.cross(up, end - middle)
            away = [np.einsum("pd,pd->p", each - middle, across) for each in (one, other)]
            part = np.clip(away[0] / np.where(away[0] == away[1], 1, away[0] - away[1]), 0, 1)
            weights, to_weights = np.zeros((2, len(some), 3))
            weights[:, i] = 1 - part
            weights[:, j] = part
            part = _part(_between(one, other, part), middle, end)
            to_weights[:, 0] = 1 - part
            to_weights[:, 1] = part
            face = self.other.rest.neighbors[face, np.where(left, (place + 2) % 3, place)]
            going = (face != last) & (face >= 0)
            to_weights[(face < 0) | going & (more == 0)] = np.nan
            yield (
                _Pairs(some, weights, np.stack([hub[some], rim, rim], axis=1), to_weights),
                np.where(left, 1, -1),
            )
            if not going.any():
                return
            some, face, last, middle, one, other, up, left = (
                each[going] for each in (some, face, last, middle, one, other, up, left)
            )


def _joined(pairs: list[_Pairs]) -> _Pairs:
    return _Pairs(
        *(np.concatenate(each) for each in zip(*(vars(one).values() for one in pairs), strict=True))
    )


def _part(points: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How far from begin to end the closest point lies, (p,) in [0, 1].

    points, begin, end: (p, 3).
    """
    side = end - begin
    return (
        np.einsum("pd,pd->p", points - begin, side)
        / np.maximum(np.einsum("pd,pd->p", side, side), 1e-300)
    ).clip(0, 1)


def _between(begin: np.ndarray, end: np.ndarray, part: np.ndarray) -> np.ndarray:
    return begin + part[:, None] * (end - begin)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Of vectors (..., 3)."""
    return np.sqrt(np.einsum("...d,...d->...", vectors, vectors))
