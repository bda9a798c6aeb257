"""Search for the LOD of few triangles that deviates by a length at most.

Each object of a character has a curve, deviation over triangles, of the LODs that were tried. A
length reads counts off the curves, and what is made of them is estimated, all objects together, as
they are seen together: an object that is too far off, or much nearer than it may be, is read once
more. Then the whole is measured, and if that is too far off, the curves learn where.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.levels.selection import read_curve
from ...crowd_lod.progress import Workload, run_in_thread
from .deviation import Measure
from .dispensable import find_dispensable
from .level_objects import LEAST, discard
from .source_mesh import Source

USUAL = 1.065  # usual bound of a LOD, as a multiple of its estimated deviation
# parts of the length: what a try aims at, and what it may deviate by at least to be near enough
AIM = 0.93
CLOSE = 0.8
TRIES = 3  # of an object before the whole is measured, at most; as many more where none fits
MEASURES = 4  # of the whole, at most
MOST_STEP = 4.0  # times as many triangles as all tries before, or as few, a try has at most
ALIKE = 0.02  # ratios that differ by this part give the same LOD, about
STEP = 1.3  # times as many triangles a try has where as many as the curve tells are too few
NEARLY_ALL = 0.9  # of the triangles: with more a LOD is hardly worth a try but as the whole itself
# What stands in for objects left out may be off by this part of the length at least.
NEAREST = 0.1
BELOW = 1e-9  # a division by less says nothing
LEFT = 0.3  # part of a search that is left after the first measurement of the whole, on average
FITTED = 0.6  # part of a try of a length after which the whole is measured
LEFT_OF_ROUND = 0.4  # part of the tries that is left after one, on average
TRIED = 0.6  # part of such a round that making takes; the rest is to estimate what was made

Figures = tuple[float, float, float, float]  # see Measure.level
Make = Callable[[Source, float], Generator[Any, None, tuple[bpy.types.Object, int, int]]]


@dataclass(eq=False)
class Try:
    """An object of a LOD that was made.

    item: it; vertices, triangles: how many it has; ratio: the part of the triangles asked for.
    deviation: meters, as far as is known.
    """

    item: bpy.types.Object
    vertices: int
    triangles: int
    ratio: float
    deviation: float = 0.0


@dataclass
class LodCurve:
    """What is known of an object's LODs.

    source: the object's.
    known_tries: of all lengths; tries: those of this length, whose objects are still there.
    dispensable: whether LODs of this length leave the object out.
    again: a ratio to try once more, as something weighs more now; 0 for none; weighed: whether that
        was so for this length.
    evaluated: (n,) which vertex of the evaluated object each of the source's is; None before that
        is asked for.
    """

    source: Source
    known_tries: list[Try] = field(default_factory=list)
    tries: list[Try] = field(default_factory=list)
    dispensable: bool = False
    again: float = 0.0
    weighed: bool = False
    evaluated: np.ndarray | None = None

    @property
    def count(self) -> int:
        """How many triangles the source has."""
        return len(self.source.geometry.triangles) if self.source.mesh else 0

    def ratio_for(self, length: float) -> float:
        """Return the part of the triangles with which a LOD deviates by `length` meters.

        Some try must be known. The first of a length has no more than a smooth surface would need:
        half the triangles are twice as far off.
        """
        pairs = [(max(each.deviation, length / MOST_STEP), each.ratio) for each in self.known_tries]
        ratio = float(read_curve([AIM * length], pairs, -1.0)[0])
        if not self.tries:
            off, part = max((pair for pair in pairs if pair[0] <= length), default=(length, ratio))
            ratio = min(ratio, part * off / (AIM * length))
        ratios = [part for _, part in pairs]
        most = max(ratios)
        ratio = min(max(ratio, min(ratios) / MOST_STEP), most * MOST_STEP)
        if ratio >= 1.0 and most < NEARLY_ALL:
            ratio = most**0.5  # all triangles would tell nothing: half the way there
        return min(max(ratio, LEAST / max(self.count, 1)), 1.0)

    def best(self, length: float) -> Try:
        """Return the try of fewest triangles that deviates by `length` at most, or the nearest."""
        fitting = [attempt for attempt in self.tries if attempt.deviation <= length]
        if not fitting:
            return min(self.tries, key=lambda attempt: attempt.deviation)
        return min(fitting, key=lambda attempt: attempt.triangles)

    def next_try(self, length: float, about: float) -> float | None:
        """Return the ratio to try next; None if the best try will do.

        length: meters; about: the ratio if nothing is known.
        """
        if self.dispensable or not self.count:
            whole = 0.0 if self.dispensable else 1.0
            return None if self.tries else whole
        if not self.known_tries:
            return about
        if self.again:
            ratio, self.again = self.again, 0.0
            return ratio
        near_enough = CLOSE * length if len(self.tries) < TRIES else 0.0
        if self.tries and near_enough <= self.best(length).deviation <= length:
            return None
        ratio = self.ratio_for(length)
        tried = [attempt.ratio for attempt in self.tries]
        if not any(abs(ratio / other - 1) < ALIKE for other in tried):
            return ratio
        if self.best(length).deviation <= length or max(tried) == 1.0:
            return None
        return min(1.0, STEP * max(tried))

    def bring_back(self) -> None:
        """Let LODs of this length have the object that those before left out."""
        self.dispensable = False
        discard([attempt.item for attempt in self.tries])
        self.tries = []

    def end_length(self, chosen: Sequence[Try]) -> None:
        """Remove the objects that were tried for a length, but for the chosen ones."""
        discard([attempt.item for attempt in self.tries if attempt not in chosen])
        self.tries = []
        self.weighed = False


class Search:
    """The search of one character's LODs, which learns from each.

    sources: the character's objects.
    make: makes an object of a source with a ratio, and yields between its steps.
    by: what measures the LODs.
    """

    def __init__(self, sources: Sequence[Source], make: Make, by: Measure):
        self.make = make
        self.by = by
        self.curves = [LodCurve(source) for source in sources]
        self.nearness = 1.0  # see NEAREST
        self.looked = False  # whether a LOD was looked at between the poses

    def find(
        self, length: float, about: float
    ) -> Generator[float, None, tuple[list[Try], Figures]]:
        """Find the LOD of few triangles whose bound is `length` meters at most.

        about: the part of the triangles that it takes, as far as is known.
        Yields the progress. Returns its objects and what was measured of them. Where none fits,
        these are those of the least bound.
        """
        aim = length / USUAL
        work = Workload(1)
        yield from work.take(self._leave_out(aim))
        found: list[tuple[list[Try], Figures]] = []
        for _ in range(MEASURES):
            cost = (1 - LEFT) * work.left
            yield from work.take(self._fit(aim, about), FITTED * cost)
            objects = self._best(aim)
            if any(objects == before for before, _ in found):
                break
            measured = yield from work.take(self._measure(objects), (1 - FITTED) * cost)
            found.append((objects, measured))
            if measured[1] <= length:
                break
            yield from work.take(self._learn(objects, measured[1] / USUAL))
            self._mend_left_out(aim)
        best = min(found, key=lambda each: max(each[1][1], length))
        for curve in self.curves:
            curve.end_length(best[0])
        return best

    def _measure(self, objects: list[Try]) -> Generator[float, None, Figures]:
        """Measure a LOD; the first one of the character also in frames between the poses.

        Yields the progress.
        """
        items = [attempt.item for attempt in objects]
        work = Workload(2)
        measured = yield from work.take(self.by.level(items, 1), 1)
        if not self.looked:
            self.looked = True
            (measured,) = yield from work.take(self.by.look_between([items], [measured]), 1)
        return measured

    def _learn(self, objects: list[Try], deviation: float) -> Iterator[float]:
        """Note that a LOD deviates by more than was estimated, as the whole measure has found.

        Where it is off, the character weighs more from now on, and as many triangles are tried
        again. If it did already, as few triangles count as no nearer. Yields between steps.

        deviation: meters, as estimates are.
        """
        around = yield from run_in_thread(self.by.worst_vertices)
        for number, vertices in enumerate(around):
            curve = self.curves[number]
            if not (len(vertices) and curve.count):
                continue
            source = curve.source
            if curve.evaluated is None:
                points = source.skin.place[0] if source.skin else source.geometry.points
                finding = partial(self.by.vertices_at, number, points)
                curve.evaluated = yield from run_in_thread(finding)
            ratio = objects[number].ratio
            spots = np.isin(curve.evaluated, vertices)
            if source.decimation and source.decimation.weigh(spots) and not curve.weighed:
                curve.weighed = True
                curve.again = ratio
            for attempt in curve.known_tries:
                if attempt.ratio <= ratio:
                    attempt.deviation = max(attempt.deviation, deviation)

    def _fit(self, length: float, about: float) -> Generator[float, None, None]:
        """Try until each object's best try deviates by about `length`, as estimated.

        Yields the progress.
        """
        work = Workload(1)
        for _ in range(2 * TRIES):
            cost = (1 - LEFT_OF_ROUND) * work.left
            near = length * self.nearness
            plans = [curve.next_try(near, about) for curve in self.curves]
            if all(ratio is None for ratio in plans):
                if not self._mend_left_out(length):
                    return
                continue
            attempts = yield from work.take(self._try(plans), TRIED * cost)
            objects = [
                new or curve.best(near) for new, curve in zip(attempts, self.curves, strict=True)
            ]
            yield from work.take(self.by.read())
            estimate = yield from work.take(self.by.estimate([each.item for each in objects]))
            work.did((1 - TRIED) * cost)
            for new, curve, deviation in zip(attempts, self.curves, estimate, strict=True):
                if new:
                    new.deviation = deviation
                    if curve.count and not curve.dispensable:
                        curve.known_tries.append(new)
            for curve, deviation in zip(self.curves, estimate, strict=True):
                if curve.dispensable:
                    curve.tries[0].deviation = deviation

    def _best(self, length: float) -> list[Try]:
        """Return the best try of each object for a LOD that deviates by `length` at most."""
        return [curve.best(length * self.nearness) for curve in self.curves]

    def _leave_out(self, length: float) -> Iterator[float]:
        """Find which objects a LOD of the length may leave out; yield between steps."""
        yield from self.by.read()
        self.nearness = 1.0
        if len(self.curves) > 1:
            dispensable = yield from run_in_thread(
                lambda: find_dispensable(self.by.character, length)
            )
            for curve, is_dispensable in zip(self.curves, dispensable, strict=True):
                curve.dispensable = bool(is_dispensable) and curve.count > 0

    def _mend_left_out(self, length: float) -> bool:
        """Mend a LOD that is farther than `length` from objects that it leaves out.

        Some of these come back, the worst first, and the other objects come near enough for those
        still left out. Their number is the one that takes the fewest triangles, about. Returns
        whether there was anything to mend.
        """
        left_out = [curve for curve in self.curves if curve.dispensable and curve.tries]
        left_out.sort(key=lambda curve: -curve.tries[0].deviation)
        deviations = np.array([curve.tries[0].deviation for curve in left_out])
        count = int((deviations > length).sum())
        if not count:
            return False
        objects = [
            attempt for attempt in self._best(length) if attempt.triangles and attempt.deviation
        ]
        off = max((attempt.deviation for attempt in objects), default=0.0)
        triangles = sum(attempt.triangles for attempt in objects)
        # for each number of objects that come back: the part of their present deviation that the
        # others may then have
        nearness = np.ones(count + 1)
        nearness[:count] = (off + length - deviations[:count]) / max(off, BELOW * length)
        costs = np.arange(count + 1) * LEAST + triangles / nearness.clip(BELOW)
        costs[self.nearness * nearness < NEAREST] = np.inf
        back = int(costs.argmin())
        self.nearness *= float(nearness[back])
        for curve in left_out[:back]:
            curve.bring_back()
        return True

    def _try(self, plans: Sequence[float | None]) -> Generator[float, None, list[Try | None]]:
        """Make a try of the ratio that is planned for each source; yields the progress."""
        work = Workload(len(plans))
        attempts: list[Try | None] = []
        for ratio, curve in zip(plans, self.curves, strict=True):
            new = None
            if ratio is not None:
                made = yield from work.take(self.make(curve.source, ratio))
                new = Try(*made, ratio)
                curve.tries.append(new)
            attempts.append(new)
            yield work.did(1)
        return attempts
