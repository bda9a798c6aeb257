"""Surfaces of triangles: nearest points, samples, and distances between two."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...crowd_lod.mesh import Mesh
from ...crowd_lod.simplification.moving_surface import MovingSurface
from ...crowd_lod.simplification.triangle_mesh import ranges

ANYWHERE = 1e19  # meters: as far as a search may go
ROUNDED = 1e-5  # part of a distance, more than float32 rounds away
# In float32 the tree errs at a triangle of longest side s and height h by LOST s^3 / h^2. NEAR, a
# part of the surface's size, is how much it may err.
LOST = 4e-8
NEAR = 5e-5
# Triangles where samples are farthest off are looked at closer: CLOSER of them, divided up to
# HALVED times.
CLOSER = 400
HALVED = 5
LAYERS = 8  # of clothes about a body that a way through a surface passes, at most
FLAT = 1e-6  # a triangle lower than this part of its longest side shows nothing


class Surface(Mesh):
    """A triangle surface with queries for nearest points, which are float64 meters.

    Blender's BVH tree stores float32. To lose little precision it is built relative to the middle
    of the points. It cannot find the way to very thin triangles, so it also holds lines along
    these.
    """

    def __init__(self, points: np.ndarray, triangles: np.ndarray):
        super().__init__(np.asarray(points, np.float64), np.asarray(triangles))

    @cached_property
    def middle(self) -> np.ndarray:
        """Return the middle (3,) of the box about the points, meters."""
        return (self.points.min(axis=0) + self.points.max(axis=0)) / 2

    @cached_property
    def lines(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lines along the triangles that are too thin for the BVH tree.

        They run along the longest side of each, and are so dense that every point of the triangle
        is within NEAR of the surface's size.

        ends: (l, 2, 3) meters.
        triangle: (l,) triangle of each line.
        """
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        squares = np.stack([np.einsum("md,md->m", side, side) for side in (b - a, c - b, a - c)])
        longest = squares.max(axis=0, initial=0)
        # the area, squared
        doubled = squares[0] * squares[2] - np.einsum("md,md->m", b - a, a - c) ** 2
        near = NEAR * float(np.ptp(self.points, axis=0).max())
        thin = np.flatnonzero(LOST * longest**2.5 > near * doubled)
        height = np.sqrt(doubled[thin].clip(0) / longest[thin])
        count = np.ceil(height / near).astype(np.intp).clip(1)
        triangle = np.repeat(thin, count)
        number = ranges(np.zeros_like(count), count)
        up = (number / np.repeat(count, count))[:, None]
        first = squares[:, triangle].argmax(axis=0)
        a, b, c = (self.points[self.triangles[triangle, (first + k) % 3]] for k in range(3))
        return np.stack([a + up * (c - a), b + up * (c - b)], axis=1), triangle

    @cached_property
    def tree(self) -> BVHTree:
        ends = self.lines[0].reshape(-1, 3)
        a, b = np.arange(len(ends)).reshape(-1, 2).T + len(self.points)
        triangles = np.concatenate([self.triangles, np.stack([a, b, b], axis=1)])
        return BVHTree.FromPolygons(
            (np.concatenate([self.points, ends]) - self.middle).tolist(), triangles.tolist()
        )

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the surface's nearest points to `points`, (k, 3).

        at: (k, 3) meters.
        triangle: (k,) intp.
        distance: (k,) meters.
        """
        hits = list(self._hits(points))
        at = np.array([hit[0] for hit in hits], np.float64).reshape(-1, 3) + self.middle
        return at, self._faces[[hit[2] for hit in hits]], np.array([hit[3] for hit in hits])

    def nearest_faces(self, points: np.ndarray) -> np.ndarray:
        """Return the triangles (k,) intp nearest to `points` (k, 3): part of `nearest`, faster."""
        return self._faces[[hit[2] for hit in self._hits(points)]]

    @cached_property
    def _faces(self) -> np.ndarray:
        """The triangle that each of the tree's is of, (t,) intp."""
        return np.concatenate([np.arange(len(self.triangles)), self.lines[1]])

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (k,) meters of `points` (k, 3) to the surface.

        This is faster than `nearest`.
        """
        return np.array([hit[3] for hit in self._hits(points)], np.float64)

    def _hits(self, points: np.ndarray) -> Iterator[tuple]:
        """Yield the tree's result for each of `points` (k, 3).

        A point's distance is at most that of the point before plus the way between them, but for
        rounding. This limits the search.
        """
        points = points - self.middle
        find = self.tree.find_nearest
        ways = (
            np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
            + ROUNDED * np.ptp(self.points, axis=0).max()
        )
        most = ANYWHERE
        for point, way in zip(points.tolist(), ways.tolist(), strict=True):
            hit = find(point, most + way)
            hit = hit if hit[3] is not None else find(point)
            most = hit[3] * (1 + ROUNDED)
            yield hit

    def through(self, points: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Return how far it is from `points` inside the surface, or on it, to the outside.

        points: (k, 3); ways: (k, 3), of unit length. A way ends at the first triangle seen from its
        back. Triangles seen from their front lie inside, as a body does in its clothes. Returns
        (k,) meters, infinite where a way does not end.
        """
        lengths = np.full(len(points), np.inf)
        step = ROUNDED * float(np.ptp(self.points, axis=0).max())
        cast = self.tree.ray_cast
        for k, (start, way) in enumerate(zip(points - self.middle, ways, strict=True)):
            at = Vector(start)
            way = Vector(way)
            far = 0.0
            for _ in range(LAYERS):
                at = at + step * way
                far = far + step
                hit, normal, _, length = cast(at, way)
                if hit is None:
                    break
                at = hit
                far = far + length
                if normal.dot(way) > 0:
                    lengths[k] = far
                    break
        return lengths

    def meets(self, points: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Return which lines through points (k, 3) meet the surface, (k,) bool.

        ways: (k, 3), of unit length.
        """
        size = float(np.linalg.norm(np.ptp(self.points, axis=0)))
        cast = self.tree.ray_cast
        begins = points - self.middle - size * ways
        return np.array(
            [
                cast(*line)[0] is not None
                for line in zip(begins.tolist(), ways.tolist(), strict=True)
            ],
            bool,
        )

    def facing(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the surface's nearest points to `points`, and its normals there.

        Both are (k, 3): meters, and of unit length.
        """
        at, triangle, _ = self.nearest(points)
        a, b, c = (self.points[self.triangles[triangle, i]] for i in range(3))
        return at, np.cross(b - a, c - a) / self.area[triangle, None]

    @cached_property
    def area(self) -> np.ndarray:
        """Return twice the area of each triangle: (m,) square meters."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @property
    def corners(self) -> np.ndarray:
        """Return the points (k, 3) that triangles use, meters."""
        return self.points[np.unique(self.triangles)]

    def at(self, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return points (k, 3) meters at barycentric `weights` (k, 3) of triangles (k,)."""
        return np.einsum("kc,kcd->kd", weights, self.points[self.triangles[triangle]])

    def samples(self, count: int) -> np.ndarray:
        """Return points (k, 3) meters: the corners, then `count` spread evenly by area.

        Only the corners if the surface has no area.
        """
        return (
            np.concatenate([self.corners, self.at(*scattered(self.area, count))])
            if self.area.any()
            else self.corners
        )


def scattered(area: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `count` points spread evenly by area: (triangle, barycentric weights).

    The result is (count,) and (count, 3), always the same for the same input.

    area: (m,) of the triangles, not all 0.
    """
    random = np.random.default_rng(0)
    face = np.searchsorted(
        np.cumsum(area) / area.sum(), (np.arange(count) + random.random(count)) / count
    )
    root = np.sqrt(random.random(count))
    v = random.random(count)
    return face.clip(0, len(area) - 1), np.stack([1 - root, root * (1 - v), root * v], axis=1)


def has_area(corners: np.ndarray) -> np.ndarray:
    """Return which triangles (m, 3, 3) are not degenerate: (m,) bool.

    A degenerate triangle is lower than FLAT of its longest side, and shows nothing.
    """
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1, initial=0)
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > FLAT * longest**2


def spatial_order(points: np.ndarray) -> np.ndarray:
    """Return (n,) intp, an order of points (n, 3) in which neighbors in space are near each other.

    It is that of Morton codes, with 1,024 cells along each axis.
    """
    size = float(np.ptp(points, axis=0).max()) or 1.0
    cells = (1023 * (points - points.min(axis=0)) / size).astype(np.int64)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cells = (cells | cells << shift) & mask
    return np.argsort(cells @ (1, 2, 4), kind="stable")


@dataclass
class Merged:
    """A surface in several poses, points at the same place merged: importers split them.

    moving: without loose points, and triangles that have no area in any pose.
    source: (n,) for each point of that one of those given; place: (given,) the reverse, -1 for
        loose points.
    with_area: (given triangles,) bool, those with area.
    """

    moving: MovingSurface
    source: np.ndarray
    place: np.ndarray
    with_area: np.ndarray


def merge(points: Sequence[np.ndarray], triangles: np.ndarray) -> Merged | None:
    """Return the surface in several poses, or None if it has no faces.

    points: for each pose (n, 3) meters.
    triangles: (m, 3).
    """
    with_area = np.any([has_area(pose_points[triangles]) for pose_points in points], axis=0)
    if not with_area.any():
        return None
    vertices, triangles = np.unique(triangles[with_area], return_inverse=True)
    every = np.ascontiguousarray(
        np.stack([pose_points[vertices] for pose_points in points], axis=1).reshape(
            len(vertices), -1
        )
    )
    _, first, number = np.unique(
        every.view(f"V{every.shape[1] * 8}").ravel(), return_index=True, return_inverse=True
    )
    # neighbors beside each other: a tree then finds what is nearest to points in half the time
    order = spatial_order(points[0][vertices[first]])
    first = first[order]
    rank = np.argsort(order)
    number = rank[number]
    every = every[first].reshape(len(first), -1, 3)
    triangles = number[triangles].reshape(-1, 3)
    surfaces = [None] * len(points)

    def find(pose: int, at: np.ndarray) -> np.ndarray:
        if surfaces[pose] is None:
            surfaces[pose] = Surface(every[:, pose], triangles)
        return surfaces[pose].nearest_faces(at)

    place = np.full(len(points[0]), -1)
    place[vertices] = number
    return Merged(MovingSurface(every, triangles, find), vertices[first], place, with_area)


def same_faces(faces: np.ndarray, other_faces: np.ndarray) -> bool:
    """Return whether two triangulations (m, 3) have the same faces.

    Quads may be cut along either diagonal: Blender cuts them the other way where a pose folds them.
    """
    if faces.shape != other_faces.shape:
        return False
    changed = (faces != other_faces).any(axis=1)
    if changed.sum() % 2:
        return False
    quads = [
        np.sort(corner_ids[changed].reshape(-1, 6), axis=1) for corner_ids in (faces, other_faces)
    ]
    corner_ids = [
        quad[np.pad(quad[:, 1:] != quad[:, :-1], ((0, 0), (1, 0)), constant_values=True)]
        for quad in quads
    ]
    return all(len(corners) == 4 * len(quads[0]) for corners in corner_ids) and np.array_equal(
        *corner_ids
    )


def deviation(first: Surface, second: Surface, count: int) -> tuple[float, float]:
    """Return (symmetric Hausdorff distance, root mean square) of surfaces, meters.

    Distances are measured at vertices, centers of triangles, and `count` samples of each surface.
    The triangles farthest off are then divided up to HALVED times and measured more densely. The
    root mean square is of the samples alone.

    The true Hausdorff distance is at least the result. Between samples it exceeds it by at most
    their spacing. Sources: Aspert, Santa-Cruz, Ebrahimi, "MESH: measuring errors between surfaces
    using the Hausdorff distance", 2002; for the division Guthe, Borodin, Klein, "Fast and accurate
    Hausdorff distance calculation between meshes", 2005.
    """
    found = [_away(a, b, count) for a, b in ((first, second), (second, first))]
    return max(most for most, _ in found), max(rms for _, rms in found)


def spread(surface: Surface, other: Surface, counted: Sequence[np.ndarray], count: int) -> float:
    """Return the root mean square distance of two surfaces, meters.

    It is measured at `count` samples of the triangles of each that count, to the other. The larger
    one is returned.

    counted: of each surface which triangles count, (m,) bool.
    """
    means = [0.0]
    for a, b, faces in ((surface, other, counted[0]), (other, surface, counted[1])):
        area = a.area * faces
        if area.any():
            means.append(float(np.sqrt(np.mean(b.distances(a.at(*scattered(area, count))) ** 2))))
    return max(means)


def _away(surface: Surface, other: Surface, count: int) -> tuple[float, float]:
    """Return (largest distance, root mean square) from `surface` to `other`, meters."""
    vertices, triangles = np.unique(surface.triangles, return_inverse=True)
    corners = other.distances(surface.points[vertices])
    if not surface.area.any():
        return float(corners.max()), float(np.sqrt(np.mean(corners**2)))
    at = surface.points[surface.triangles]
    off = corners[triangles.reshape(-1, 3)]
    face, weights = scattered(surface.area, count)
    even = other.distances(surface.at(face, weights))  # the corners are no even sample of the area
    worst = np.maximum(off.max(axis=1), other.distances(at.mean(axis=1)))
    np.maximum.at(worst, face, even)
    most = worst.max()
    for _ in range(HALVED):
        far = np.argsort(-worst, kind="stable")[:CLOSER]
        at = at[far]
        off = off[far]
        middles = (at + np.roll(at, -1, axis=1)) / 2
        between = other.distances(middles.reshape(-1, 3)).reshape(-1, 3)
        most = max(most, between.max())
        at, off = (
            np.concatenate([_quarters(*each), each[1]]) for each in ((at, middles), (off, between))
        )
        worst = off.max(axis=1)
        # what is as far off as can be lies between the corners
        longest = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).max(axis=1)
        still = worst + longest / np.sqrt(3) > most
        at = at[still]
        off = off[still]
        worst = worst[still]
        if not len(at):
            break
    return float(most), float(np.sqrt(np.mean(even**2)))


def _quarters(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return the three outer quarters, (3 m, 3, ...), of triangles.

    corners: (m, 3, ...) values at the corners.
    middles: (m, 3, ...) values in the middle of the side from each corner to the next.
    """
    return np.concatenate(
        [np.stack([corners[:, i], middles[:, i], middles[:, i - 1]], axis=1) for i in range(3)]
    )
