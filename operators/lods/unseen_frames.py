"""Frames besides the measured poses, in which a LOD may deviate by more than its bound.

Many frames are looked at, in each only the places that deviate most. That is no proof, but it finds
a bend of a joint that no measured pose has.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...crowd_lod.progress import Pauses, Workload, run_in_thread
from ...crowd_lod.simplification.closest_point import closest_weights
from ...crowd_lod.simplification.hausdorff import (
    SurfacePoints,
    bound_distance,
    places_on,
    upper_distances,
)
from ..blender.performance import Performance
from .posed_shapes import Posed
from .posed_surface import Measured, PosedSurface, large_pieces
from .surface import Merged, Surface

MOMENTS = 200  # that are looked at, evenly, at most: frames and up to EACH sub-frames of a frame
EACH = 4
PEAKS = 40  # further moments beside those where LODs are farthest off, about
WHOLE_LOOKS = 3  # moments in which the whole of a LOD is measured together, at most
ALIKE_WITHIN = 3.0  # frames: of moments that are closer together one is measured at a time
# Places are watched in cells, CELLS across the character. The LIKELY places of a cell that may
# deviate most are measured in all poses, and the WORST of them are watched.
CELLS = 20
LIKELY = 12
WORST = 4
# A place that is nearer than this part of the farthest place's distance in all poses is not the
# farthest between them.
QUIET = 0.15


@dataclass
class Watched:
    """Places of one surface, and what of another surface was nearest to each in some pose.

    places: w of them.
    place: (q,) of pairs; triangle: (q, 3) points of the other surface.
    """

    places: SurfacePoints
    place: np.ndarray
    triangle: np.ndarray

    def look_closer(
        self, points: np.ndarray, other: np.ndarray, whole: Merged, beyond: float
    ) -> bool:
        """Return whether a place is farther than `beyond` meters from all of the other surface.

        What is nearest to places is held against them from then on.

        points, other: (n, 3) of the two surfaces in some frame; whole: the other one.
        """
        far = np.flatnonzero(self.distances(points, other) > beyond)
        if not len(far):
            return False
        surface = Surface(other[whole.source], whole.moving.triangles)
        _, triangle, distance = surface.nearest(self.places.at(points)[far])
        self.place = np.concatenate([self.place, far])
        self.triangle = np.concatenate(
            [self.triangle, whole.source[whole.moving.triangles[triangle]]]
        )
        return bool(distance.max() > beyond)

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


def watch(merged: Merged, other: Merged) -> Watched:
    """Choose the places of `merged` to watch: in each cell of the first pose those farthest off."""
    surface = merged.moving
    places = places_on(surface.pieces, surface.pieces[large_pieces(surface)])
    at = places.at(surface.points[:, 0])
    size = float(np.ptp(at, axis=0).max()) or 1.0
    cell = np.floor(CELLS * (at - at.min(axis=0)) / size).astype(np.intp) @ (1, 100, 10_000)
    most = upper_distances(surface, other.moving, places)
    likely = _worst_of(cell, most, LIKELY)
    places = places.of(likely)
    cell = cell[likely]
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
    worst = worst[distance[worst] >= QUIET * distance.max(initial=0)]
    pairs = np.unique(
        [np.tile(np.arange(len(worst)), len(nearest)), np.stack(nearest)[:, worst].ravel()], axis=1
    )
    watched = places.of(worst)
    watched.corners = merged.source[watched.corners]
    return Watched(watched, pairs[0], other.source[other.moving.triangles[pairs[1]]])


def _worst_of(cell: np.ndarray, distance: np.ndarray, count: int) -> np.ndarray:
    """Return up to `count` places of each cell, those of the greatest distance.

    cell, distance: (w,) of all places.
    """
    order = np.lexsort((-distance, cell))
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(begins, np.diff(begins, append=len(order)))
    return order[rank < count]


def moments_between(performance: Performance, most: int = MOMENTS) -> list[float]:
    """Return moments of all actions, evenly, up to EACH a frame and `most` in all."""
    lengths = np.array([end - begin for begin, end in performance.spans])
    counts = (
        np.minimum(EACH * lengths, most * lengths / max(lengths.sum(), 1e-9)).round().astype(int)
    )
    spans = zip(performance.spans, counts, strict=True)
    return [begin + (end - begin) * (k + 0.5) / n for (begin, end), n in spans for k in range(n)]


def moments_beside(moments: Sequence[float], off: np.ndarray) -> list[float]:
    """Return moments between those where LODs are farthest off and their neighbors.

    moments: (k,), ascending; off: (LODs, k) meters.
    """
    several = max(1, PEAKS // (4 * len(off)))
    worst = np.unique(np.argsort(-off, axis=1)[:, :several])
    beside = [
        (moments[k], moments[k + step])
        for k in worst
        for step in (-1, 1)
        if 0 <= k + step < len(moments)
    ]
    return [one + part * (other - one) for one, other in beside for part in (0.25, 0.5)]


def look_at(
    posed: Posed, moments: Sequence[float], pairs: Sequence[tuple[Watched, Watched]]
) -> Generator[float, None, np.ndarray]:
    """Return how far each LOD is off in each of `moments` at most, (LODs, moments) meters.

    posed: the character and its LODs; pairs: for each LOD what is watched of the character, and of
    the LOD. Yields the progress.
    """
    distances = np.zeros((len(pairs), len(moments)))
    work = Workload(len(moments))
    pauses = Pauses()
    for number, moment in enumerate(moments):
        character, *levels = posed.points(moment)
        for k, ((mine, theirs), level) in enumerate(zip(pairs, levels, strict=True)):
            off = mine.distances(character, level), theirs.distances(level, character)
            distances[k, number] = max(each.max(initial=0) for each in off)
        yield from pauses.after(work.did(1), posed.performance.rest)
    posed.performance.rest()
    return distances


@dataclass
class Looked:
    """A LOD and what is known of it in moments that no pose has.

    number: the LOD's, of those that `posed` has; surfaces: the character and the LOD, in the poses.
    watched: what is watched of either; moments, off: (k,) as `look_at` tells, 0 once it is known.
    measured: moments in which the whole was measured.
    """

    posed: Posed
    number: int
    surfaces: tuple[PosedSurface, PosedSurface]
    watched: tuple[Watched, Watched]
    moments: np.ndarray
    off: np.ndarray
    measured: list[float] = field(default_factory=list)

    def measure(self, row: Measured, beyond: float) -> Generator[float, None, Measured | None]:
        """Measure the whole LOD where a watched place is farther off than `beyond` meters.

        row: what is known of it. Returns the same, with a greater bound if a moment exceeds that;
        None if there is no such place. Yields between steps.
        """
        exceeding = yield from self._exceeding(beyond)
        if not exceeding:
            return None
        self.measured += [moment for moment, _ in exceeding]
        merged, other = (
            surface.at([points[k] for _, points in exceeding])
            for k, surface in enumerate(self.surfaces)
        )
        if merged is None or other is None:
            return row
        deviation, bound, rms, worst = row
        apart = yield from run_in_thread(lambda: bound_distance(merged.moving, other.moving, bound))
        if apart.measured > deviation:
            deviation = apart.measured
            worst = exceeding[apart.pose][0]
        return deviation, max(bound, apart.bound), rms, worst

    def _exceeding(
        self, beyond: float
    ) -> Generator[float, None, list[tuple[float, tuple[np.ndarray, np.ndarray]]]]:
        """Find moments that are not alike, in which a watched place is farther than `beyond`.

        Yields between steps and returns them, with where the points of both surfaces are then.
        """
        whole = [surface.surface(surface.runs[0]) for surface in self.surfaces]
        exceeding = []
        left = self.off.copy()
        while len(exceeding) < WHOLE_LOOKS and left.max() > beyond:
            k = int(left.argmax())
            left[k] = self.off[k] = 0.0
            moment = float(self.moments[k])
            points = self.posed.points(moment)
            self.posed.performance.rest()
            moved_pair = points[0], points[1 + self.number]
            if (yield from run_in_thread(partial(self._is_beyond, moved_pair, whole, beyond))):
                exceeding.append((moment, moved_pair))
                left[np.abs(self.moments - moment) < ALIKE_WITHIN] = 0.0
        return exceeding

    def _is_beyond(
        self, moved_pair: tuple[np.ndarray, np.ndarray], whole: list[Merged], beyond: float
    ) -> bool:
        """Return whether a watched place of either surface is farther than `beyond` meters."""
        ways = zip(self.watched, (moved_pair, moved_pair[::-1]), whole[::-1], strict=True)
        return any(watched.look_closer(*pair, other, beyond) for watched, pair, other in ways)
