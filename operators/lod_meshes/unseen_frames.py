"""Frames besides the poses that LODs are measured in, where one may deviate by more than its bound.

At many frames only those places are looked at that deviate most. That is no proof, but it finds
the pose of a joint that no measured pose has.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.simplification.closest_point import closest_weights
from ...crowd_lod.simplification.hausdorff import Places, interval, places_on, upper_distances
from ..blender.performance import Performance
from .posed_shapes import Posed
from .posed_surface import Measured, PosedSurface, large_pieces
from .surface import Merged, Surface

MOMENTS = 200  # frames and sub-frames, evenly, that are looked at, at most
PEAKS = 40  # further ones beside those where LODs are farthest off, about
EACH = 4  # of a frame, at most
CELLS = 20  # across the character, of each of which some places are watched
# part of a bound, beyond which a watched place has the whole LOD looked at, for what lies between
# places; and how often a LOD is, at most, where no place exceeds the bound
NEAR_BOUND, WHOLE_LOOKS = 0.85, 5
LIKELY = 12  # places of a cell that are measured in all poses, those that may deviate most
WORST = 4  # places of a cell that are watched, those that do


@dataclass
class Watched:
    """Places of one surface, and what of another surface was nearest to each in some pose.

    places: w of them.
    place: (q,) of pairs; triangle: (q, 3) points of the other surface.
    """

    places: Places
    place: np.ndarray
    triangle: np.ndarray

    def distances(self, points: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return how far each place is from the other surface at most, (w,) meters.

        points, other: (n, 3) of the two surfaces in some frame.
        """
        at = self.places.at(points)[self.place]
        corners = other[self.triangle]
        weights = closest_weights(at.T, *corners.transpose(1, 2, 0)).T
        away = np.linalg.norm(at - np.einsum("qc,qcd->qd", weights, corners), axis=1)
        nearest = np.full(len(self.places.corners), np.inf)
        np.minimum.at(nearest, self.place, away)
        return nearest


def watch(one: Merged, other: Merged) -> Watched:
    """Choose the places of `one` to watch: in each cell of the first pose those farthest off."""
    surface = one.moving
    places = places_on(surface.pieces, surface.pieces[large_pieces(surface)])
    at = places.at(surface.points[:, 0])
    size = float(np.ptp(at, axis=0).max()) or 1.0
    cell = np.floor(CELLS * (at - at.min(axis=0)) / size).astype(np.intp) @ (1, 100, 10_000)
    likely = _worst_of(cell, upper_distances(surface, other.moving, places), LIKELY)

    places, cell = places.of(likely), cell[likely]
    at = places.at(surface.points)
    distance = np.zeros(len(at))
    nearest = []
    for pose in range(at.shape[1]):
        to = other.moving.find(pose, at[:, pose])
        on = other.moving.on(to, at[:, pose], pose)
        image = np.einsum("wc,wcd->wd", on, other.moving.points[other.moving.triangles[to], pose])
        distance = np.maximum(distance, np.linalg.norm(at[:, pose] - image, axis=1))
        nearest.append(to)
    worst = _worst_of(cell, distance, WORST)
    pairs = np.unique([np.tile(np.arange(len(worst)), len(nearest)), np.stack(nearest)[:, worst].ravel()], axis=1)
    watched = places.of(worst)
    watched.corners = one.source[watched.corners]
    return Watched(watched, pairs[0], other.source[other.moving.triangles[pairs[1]]])


def _worst_of(cell: np.ndarray, distance: np.ndarray, count: int) -> np.ndarray:
    """Return up to `count` places of each cell, those of the greatest distance.

    cell, distance: (w,) of all places.
    """
    order = np.lexsort((-distance, cell))
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(begins, np.diff(begins, append=len(order)))
    return order[rank < count]


def moments_between(performance: Performance) -> list[float]:
    """Return moments of all actions, evenly, up to EACH a frame and MOMENTS in all."""
    lengths = np.array([end - begin for begin, end in performance.spans])
    counts = np.minimum(EACH * lengths, MOMENTS * lengths / max(lengths.sum(), 1e-9)).round().astype(int)
    spans = zip(performance.spans, counts, strict=True)
    return [begin + (end - begin) * (k + 0.5) / n for (begin, end), n in spans for k in range(n)]


def moments_beside(moments: Sequence[float], off: np.ndarray) -> list[float]:
    """Return moments between those where LODs are farthest off and the ones beside these.

    moments: (k,), ascending; off: (LODs, k) meters.
    """
    several = max(1, PEAKS // (4 * len(off)))
    worst = np.unique(np.argsort(-off, axis=1)[:, :several])
    beside = [(moments[k], moments[k + step]) for k in worst for step in (-1, 1) if 0 <= k + step < len(moments)]
    return [one + part * (other - one) for one, other in beside for part in (0.25, 0.5)]


def look_at(posed: Posed, moments: Sequence[float], pairs: Sequence[tuple[Watched, Watched]]) -> Generator[float, None, np.ndarray]:
    """Return how far each LOD is off in each of `moments` at most, (LODs, moments) meters.

    posed: the character and its LODs; pairs: for each LOD what is watched of the character, and of
    the LOD. Yields the progress.
    """
    found = np.zeros((len(pairs), len(moments)))
    for number, moment in enumerate(moments):
        character, *levels = posed.points(moment)
        posed.performance.rest()
        for k, ((mine, theirs), level) in enumerate(zip(pairs, levels, strict=True)):
            off = mine.distances(character, level), theirs.distances(level, character)
            found[k, number] = max(each.max(initial=0) for each in off)
        yield (number + 1) / len(moments)
    return found


def exceeded(
    row: Measured,
    surfaces: tuple[PosedSurface, PosedSurface],
    points: tuple[np.ndarray, np.ndarray],
    pair: tuple[Watched, Watched],
    moment: float,
) -> Measured:
    """Return what is known of a LOD after a look at all of it at `moment`.

    row: what was known; surfaces: the character and the LOD; points: where theirs are at `moment`,
    (n, 3) each; pair: see `look_at`.
    """
    one, other = (surface.at([at]) for surface, at in zip(surfaces, points, strict=True))
    if one is None or other is None:
        return row
    deviation, bound, rms, worst = row
    ways = zip(pair, points, points[::-1], (other, one), strict=True)
    if not any(_exceeds(watched, *two, surface, NEAR_BOUND * bound) for watched, *two, surface in ways):
        return row
    found = interval(one.moving, other.moving, bound)
    if found.measured > deviation:
        deviation, worst = found.measured, float(moment)
    return deviation, max(bound, found.bound), rms, worst


def _exceeds(watched: Watched, points: np.ndarray, other: np.ndarray, surface: Merged, bound: float) -> bool:
    """Return whether a watched place is farther than `bound` from all of the other surface.

    points, other: see Watched.distances; surface: the other one, in the same frame.
    """
    far = watched.distances(points, other) > bound
    if not far.any():
        return False
    whole = Surface(surface.moving.points[:, 0], surface.moving.triangles)
    return bool(whole.distances(watched.places.at(points)[far]).max() > bound)
