"""Surfaces that move: the same triangles in several poses, and how one maps to another.

Points map to points. Pieces, triangles of one surface, map to another linearly on each of a few
parts, so a piece is no farther off than the farthest of some pairs of points.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .closest_point import closest_weights, walk
from .triangle_mesh import TriangleMesh, normals

SPOKES = 4  # edges that one side of a piece crosses, at most
# The triangle beneath a piece's corner is sought this part of the way to the piece's middle.
INSIDE = 0.1


@dataclass
class MovingSurface:
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

    def on(self, faces: np.ndarray, points: np.ndarray, pose: int) -> np.ndarray:
        """Barycentric weights (j, 3) of the points of faces closest to `points` (j, 3).

        faces: (j,); in the given pose.
        """
        return closest_weights(np.ascontiguousarray(points.T), *self.corners(faces, pose)).T

    def corners(self, faces: np.ndarray, pose: int) -> list[np.ndarray]:
        """The corners of the triangles `faces` (j,) in the pose, three times (3, j)."""
        return self.mesh(pose).vertices(faces)

    def at(self, vertices: np.ndarray, pose: int) -> np.ndarray:
        """Where points (j,) lie in the pose, (j, 3)."""
        return self.mesh(pose).points.take(vertices, 1).T

    def mesh(self, pose: int) -> TriangleMesh:
        """The surface in the pose."""
        if pose not in self._meshes:
            self._meshes[pose] = self.rest.moved(np.ascontiguousarray(self.points[:, pose].T))
        return self._meshes[pose]

    @cached_property
    def _meshes(self) -> dict[int, TriangleMesh]:
        return {}

    @cached_property
    def rest(self) -> TriangleMesh:
        """The surface in the first pose."""
        return TriangleMesh(self.points[:, 0].T, np.ascontiguousarray(self.triangles.T))


@dataclass
class Target:
    """A surface in some of its poses, to which points and pieces of another are mapped.

    Maps are found in the first of the poses, the base.
    """

    surface: MovingSurface
    poses: slice

    @property
    def base(self) -> int:
        return self.poses.start

    @property
    def base_alone(self) -> slice:
        """The base as poses."""
        return slice(self.base, self.base + 1)

    @property
    def mesh(self) -> TriangleMesh:
        """The surface in the base."""
        return self.surface.mesh(self.base)

    def on(self, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Weights (j, 3) of the points of faces (j,) closest to `points` (j, 3) in the base."""
        return self.surface.on(faces, points, self.base)

    def mix(self, corners: np.ndarray, weights: np.ndarray, poses: slice) -> np.ndarray:
        """The points (j, poses, 3) at weights (j, 3) of the surface's points (j, 3)."""
        if poses == self.base_alone:
            points = self.mesh.points
            return sum(points.take(corners[:, c], 1) * weights[:, c] for c in range(3)).T[:, None]
        return mixed(self.surface.points[:, poses], corners, weights)


def mixed(points: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Points (j, ...) at weights (j, 3) of the points (n, ...) at `corners` (j, 3).

    Whole rows are taken: NumPy is some six times faster than on several axes.
    """
    rows = points.reshape(len(points), math.prod(points.shape[1:]))
    at = sum(rows.take(corners[:, c], 0) * weights[:, c, None] for c in range(3))
    return at.reshape(len(corners), *points.shape[1:])


def length_of(vectors: np.ndarray) -> np.ndarray:
    """The lengths (...) of vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors * vectors, -1, 0)
    return np.sqrt(x + y + z)


@dataclass
class Pairs:
    """Points of pieces, and the points of the other surface that they map to.

    piece: (q,); weights: (q, 3), barycentric, on the piece; to: (q, 3), points of the other
    surface; to_weights: (q, 3), NaN where there is no map.
    """

    piece: np.ndarray
    weights: np.ndarray
    to: np.ndarray
    to_weights: np.ndarray

    def of(self, pieces: np.ndarray) -> "Pairs":
        """Those of the pieces (p,) bool alone, which are numbered anew."""
        pairs = np.flatnonzero(pieces[self.piece])
        return Pairs(
            (np.cumsum(pieces) - 1)[self.piece[pairs]],
            self.weights[pairs],
            self.to[pairs],
            self.to_weights[pairs],
        )


def piece_distances(target: Target, pairs: Pairs, corners: np.ndarray, poses: slice) -> np.ndarray:
    """How far pieces are off at most by the pairs, (p, poses) meters.

    corners: (p, 3, poses, 3). Infinite where there is no map.
    """
    corner = 3 * pairs.piece[:, None] + (0, 1, 2)
    at = mixed(corners.reshape(3 * len(corners), *corners.shape[2:]), corner, pairs.weights)
    off = length_of(at - target.mix(pairs.to, pairs.to_weights, poses))
    order = np.argsort(pairs.piece, kind="stable")
    begins = np.searchsorted(pairs.piece[order], np.arange(len(corners)))
    most = np.maximum.reduceat(off[order], begins)
    return np.where(np.isnan(most), np.inf, most)


def faces_beneath(
    target: Target, corners: np.ndarray, faces: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """The triangles (p, 3) of the target beneath pieces, near each corner.

    corners: (p, 3, 3), in the base; faces: (p, 3), weights: (p, 3, 3), where these are mapped to.
    """
    middle = corners.mean(axis=1, keepdims=True)
    inside = corners + INSIDE * (middle - corners)
    start = target.mesh.corner(faces.ravel(), weights.reshape(-1, 3).T)
    beneath, _ = walk(target.mesh, start, np.ascontiguousarray(inside.reshape(-1, 3).T))
    return beneath.reshape(-1, 3)


def map_to_one(target: Target, at: np.ndarray, beneath: np.ndarray) -> Pairs:
    """Map pieces, with corners (p, 3, 3), to one triangle each.

    Of the triangles (p, 3) beneath its corners, that to which it is nearest.
    """
    on = np.array([[target.on(faces, at[:, c]) for c in range(3)] for faces in beneath.T])
    to = target.surface.triangles[beneath]
    off = [
        [
            length_of(at[:, c] - target.mix(to[:, t], on[t, c], target.base_alone)[:, 0])
            for c in range(3)
        ]
        for t in range(3)
    ]
    best = np.max(off, axis=1).argmin(axis=0)
    pieces = np.arange(len(at))
    return _join(
        [
            Pairs(
                pieces,
                np.broadcast_to(np.eye(3)[c], at.shape[:2]),
                to[pieces, best],
                on[best, c, pieces],
            )
            for c in range(3)
        ]
    )


def map_to_neighbors(target: Target, at: np.ndarray, beneath: np.ndarray) -> Pairs:
    """Map each corner's part of a piece to the triangle beneath it.

    at: (p, 3, 3) corners; beneath: (p, 3) triangles, which must have a corner in common, the hub.
    Edges of the piece are cut where they cross spokes, the edges that meet in the hub. Where they
    go all round the hub, it is mapped as well.
    """
    to = target.surface.triangles[beneath]
    pieces = np.arange(len(at))
    common = (to[:, 0, :, None, None] == to[:, None, 1:, :]).any(axis=3).all(axis=2)
    has_hub = common.any(axis=1)
    hub = to[pieces, 0, common.argmax(axis=1)]
    pairs = []
    turned = np.zeros(len(at), np.intp)
    for c in range(3):
        weights = np.broadcast_to(np.eye(3)[c], at.shape[:2])
        pairs.append(Pairs(pieces, weights, to[:, c], target.on(beneath[:, c], at[:, c])))
    pairs[0].to_weights[~has_hub] = np.nan
    for side in ((0, 1), (1, 2), (2, 0)):
        crossing = np.flatnonzero((beneath[:, side[0]] != beneath[:, side[1]]) & has_hub)
        for cut, steps in _cross_spokes(target, at, beneath, hub, side, crossing):
            pairs.append(cut)
            turned[cut.piece] += steps
    around = np.flatnonzero(turned)
    middle = target.surface.at(hub[around], target.base).T
    weights = closest_weights(middle, *at[around].transpose(1, 2, 0)).T
    corners = hub[around, None].repeat(3, axis=1)
    pairs.append(Pairs(around, weights, corners, np.eye(3)[np.zeros_like(around)]))
    return _join(pairs)


def _cross_spokes(
    target: Target,
    at: np.ndarray,
    beneath: np.ndarray,
    hub: np.ndarray,
    side: tuple[int, int],
    pieces: np.ndarray,
) -> Iterator[tuple[Pairs, np.ndarray]]:
    """The spokes that an edge of some `pieces` crosses, one after another.

    side: the edge's two corners. Yields Pairs where it crosses, and 1 or -1 for each: the way round
    the hub.
    """
    i, j = side
    surface = target.surface
    face = beneath[pieces, i]
    last = beneath[pieces, j]
    middle = surface.at(hub[pieces], target.base)
    begin = at[pieces, i]
    end = at[pieces, j]
    up = np.add(*(normals(*surface.corners(faces, target.base)) for faces in (face, last))).T
    left = np.einsum("pd,pd->p", np.cross(begin - middle, end - middle), up) > 0
    for more in reversed(range(SPOKES)):
        place = (surface.triangles[face] == hub[pieces, None]).argmax(axis=1)
        rim = surface.triangles[face, (place + 1 + left) % 3]
        rim_at = surface.at(rim, target.base)
        across = np.cross(up, rim_at - middle)
        begin_off, end_off = (
            np.einsum("pd,pd->p", point - middle, across) for point in (begin, end)
        )
        slope = np.where(begin_off == end_off, 1, begin_off - end_off)
        part = np.clip(begin_off / slope, 0, 1)
        weights = np.zeros((len(pieces), 3))
        weights[:, i] = 1 - part
        weights[:, j] = part
        part = _part_along(begin + part[:, None] * (end - begin), middle, rim_at)
        to_weights = np.zeros((len(pieces), 3))
        to_weights[:, 0] = 1 - part
        to_weights[:, 1] = part
        face = surface.rest.neighbors[face, np.where(left, (place + 2) % 3, place)]
        going = (face != last) & (face >= 0)
        to_weights[(face < 0) | going & (more == 0)] = np.nan
        spoke = np.stack([hub[pieces], rim, rim], axis=1)
        yield Pairs(pieces, weights, spoke, to_weights), np.where(left, 1, -1)
        if not going.any():
            return
        pieces, face, last, middle, begin, end, up, left = (
            values[going] for values in (pieces, face, last, middle, begin, end, up, left)
        )


def _join(pairs: list[Pairs]) -> Pairs:
    """All pairs as one."""
    columns = zip(*(vars(some).values() for some in pairs), strict=True)
    return Pairs(*map(np.concatenate, columns))


def _part_along(points: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How far from begin to end the closest point lies, (p,) in [0, 1].

    points, begin, end: (p, 3).
    """
    side = end - begin
    along = np.einsum("pd,pd->p", points - begin, side)
    return (along / np.maximum(np.einsum("pd,pd->p", side, side), 1e-300)).clip(0, 1)
