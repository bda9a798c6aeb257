"""Search for the LOD with the fewest triangles that deviates by a length at most.

Each object of a character has a curve of its own, triangles over deviation: one that is smooth, or
that others hide, takes few. All are tried at once, and measured together, as they are seen
together.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.levels.selection import LEAST_SAVED, read_curve
from ...crowd_lod.progress import Workload, run_in_thread
from ...crowd_lod.simplification.decimate import LodMesh
from .deviation import DeviationEstimate, Measure
from .dispensable import find_dispensable
from .level_objects import LEAST, LodObject, discard
from .source_mesh import Source

LEFT = 0.1  # part of a search that is left after the first measurement of the whole, on average
FITTED = 0.72  # part of a try of a length after which the whole is measured
LEFT_OF_ROUND = 0.5  # part of the tries that is left after one, on average
TRIED = 0.4  # part of such a round that making takes; the rest is to estimate what was made
MOST_TRIES = 5  # of a length, at most, before the whole is measured
MEASURES = 3  # of the whole, at most
CLOSE = 0.92  # a LOD that deviates by this part of the length is not made coarser
TRIES = 4  # of a length, after which ROUGH, a smaller part, will do
ROUGH = 0.8
AIM = 0.96  # part of the length that tries aim at, between CLOSE and 1
# A try has at least STEP, at most MOST_STEP times as many triangles as those before, or as few.
# Where none of them fits, and the curve tells of no other, it has at least MORE times as many.
STEP = 1.08
MOST_STEP = 6.0
MORE = 1.25
USUAL = 1.08  # usual bound of a LOD, as a multiple of its estimated deviation
# Where only this part of a try's vertices is too far off, these vertices, its spots, weigh HEAVIER
# in the next tries. With more spots, or heavier ones, more is lost beside them than won at them. A
# second time wins nothing.
FEW_SPOTS = 0.003
HEAVIER = 8.0
# What stands in for objects left out may be off by this part of the length at least.
NEAREST = 0.1
BELOW = 1e-9  # a division by less says nothing

Figures = tuple[float, float, float, float]  # see Measure.level
Make = Callable[[Source, float], Generator[None, None, LodObject]]


@dataclass(eq=False)
class Try:
    """An object of a LOD that was made.

    item, vertices, triangles, shape: see LodObject; ratio: the part of the triangles asked for;
    weighed: whether spots were heavier; deviation: meters, as estimated.
    away: (n,) meters, that of each vertex of the source.
    """

    item: bpy.types.Object
    vertices: int
    triangles: int
    shape: LodMesh | None
    ratio: float
    weighed: bool = False
    deviation: float = 0.0
    away: np.ndarray = field(default_factory=lambda: np.zeros(1))

    @property
    def reachable(self) -> float:
        """Return the deviation but for a few spots, which can be mended."""
        return min(float(np.quantile(self.away, 1 - FEW_SPOTS)), self.deviation)

    @property
    def likely(self) -> float:
        """Return about the deviation of a LOD with as many triangles, whose spots are heavier."""
        return float(np.sqrt(self.reachable * self.deviation))


@dataclass
class LodCurve:
    """What is known of an object's LODs.

    source: the object's.
    known_tries: of all lengths.
    tries: those of this length, whose objects are still there.
    weighed: whether heavier spots were tried, for this length.
    dispensable: whether its LODs leave the object out.
    evaluated: (n,) which vertex of the evaluated object each of the source's is; None before that
    is asked for.
    """

    source: Source
    known_tries: list[Try] = field(default_factory=list)
    tries: list[Try] = field(default_factory=list)
    weighed: bool = False
    dispensable: bool = False
    evaluated: np.ndarray | None = None

    @property
    def count(self) -> int:
        """How many triangles the source has."""
        return len(self.source.geometry.triangles) if self.source.mesh else 0

    def ratio_for(self, length: float) -> float:
        """Return the part of the triangles with which a LOD deviates by `length` meters.

        Some try must be known.
        """
        pairs = self._measured_pairs(length)
        ratio = float(read_curve([AIM * length], pairs, -1.0)[0])
        # a try with all triangles would tell nothing: go half the way there at most
        ratio = min(ratio, max(part for _, part in pairs) ** 0.5)
        return min(max(ratio, LEAST / max(self.count, 1)), 1.0)

    def _measured_pairs(self, length: float) -> list[tuple[float, float]]:
        """Return (meters, part of the triangles) of the known tries.

        Those that deviate far less than `length` count as if it were a little less.
        """
        least = length / MOST_STEP
        tries = [attempt for attempt in self.known_tries if attempt.deviation > least]
        pairs = [
            (max(attempt.deviation if self.weighed else attempt.likely, least), attempt.ratio)
            for attempt in tries or self.known_tries
        ]
        # a try says nothing beside one of fewer triangles that is nearer
        return [
            (off, part) for off, part in pairs if not any(o < off and p < part for o, p in pairs)
        ]

    def least_triangles(self, length: float) -> float:
        """Return the triangles below which tries are known to deviate by more than `length` meters.

        Those with heavier spots, which are as near as may be. 0 where LODs leave the object out.
        """
        if self.dispensable:
            return 0.0
        too_far = (
            attempt.triangles
            for attempt in self.known_tries
            if attempt.weighed and attempt.deviation > length
        )
        return STEP * max(too_far, default=0)

    def best(self, length: float) -> Try:
        """Return the try of fewest triangles that deviates by `length` at most, or the nearest."""
        fitting = [attempt for attempt in self.tries if attempt.deviation <= length]
        if not fitting:
            return min(self.tries, key=lambda attempt: attempt.deviation)
        return min(fitting, key=lambda attempt: attempt.triangles)

    def weigh_spots(self, length: float) -> float:
        """Let the places of the last try that are too far off weigh more, if they are few.

        Returns the part of the triangles for the next try, the same again; 0 without such places.
        """
        last = self.tries[-1]
        if not last.reachable <= length < last.deviation or self.weighed:
            return 0.0
        triangles = self.source.geometry.triangles
        weight = self.source.weight
        weight = np.ones(len(self.source.geometry.points)) if weight is None else weight.copy()
        spots = last.away > length
        weight[np.unique(triangles[spots[triangles].any(axis=1)])] *= HEAVIER
        self.source.weight = weight
        self.weighed = True
        return last.ratio

    def _keep_weights_that_help(self) -> None:
        """Let all weigh alike again, where a LOD with heavier spots was no nearer than before."""
        *_, before, last = [None, *self.tries]
        if before and last.weighed > before.weighed and last.deviation >= before.deviation:
            self.source.weight = None

    def next_try(self, length: float, about: float) -> float | None:
        """Return the ratio to try next; None if the best try will do.

        length: meters; about: the ratio if nothing is known.
        """
        if self.dispensable or not self.count:
            whole = 0.0 if self.dispensable else 1.0
            return None if self.tries else whole
        if not self.known_tries:
            return about
        if not self.tries:
            return self.ratio_for(length)
        self._keep_weights_that_help()
        near_enough = CLOSE if len(self.tries) < TRIES else ROUGH
        if near_enough * length <= self.best(length).deviation <= length:
            return None
        return self._apart(self.weigh_spots(length) or self.ratio_for(length), length)

    def bring_back(self) -> None:
        """Let LODs of this length have the object that those before left out."""
        self.dispensable = False
        discard([attempt.item for attempt in self.tries])
        self.tries = []

    def end_length(self, chosen: Sequence[Try]) -> None:
        """Remove the objects that were tried for a length, but for the chosen ones."""
        discard([attempt.item for attempt in self.tries if attempt not in chosen])
        self.tries = []
        self.source.weight = None
        self.weighed = False

    def _apart(self, ratio: float, length: float) -> float | None:
        """Return `ratio`, or a greater one if it was tried; None if there is nothing to try."""
        weighs = self.source.weight is not None
        tried = [attempt.ratio for attempt in self.tries if attempt.weighed == weighs]
        if any(ratio / STEP < other < ratio * STEP for other in tried):
            if self.best(length).deviation <= length or max(tried) == 1.0:
                return None
            nearest = min(attempt.reachable for attempt in self.tries)
            return min(1.0, max(tried) * float(np.clip(nearest / length, MORE, MORE**3)))
        return ratio


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

    def find(
        self, length: float, about: float, most: int
    ) -> Generator[float, None, tuple[list[Try], Figures] | None]:
        """Find the LOD of few triangles whose bound is `length` meters at most.

        about: the part of the triangles that it takes, as far as is known; most: the triangles of
            what is there already and deviates by no more. A LOD must save LEAST_SAVED of them.

        Tries aim at the length. Where the whole is then farther off than they were estimated,
        estimates count as much more. Yields the progress. Returns the LOD's objects and what was
        measured of them, or None where none is worth it.
        """
        work = Workload(1)
        yield from work.take(self._leave_out(length / USUAL))
        worth = (1 - LEAST_SAVED) * most
        if sum(curve.least_triangles(length) for curve in self.curves) > worth:
            return None
        about = min(about, worth / sum(curve.count for curve in self.curves))
        usual = USUAL
        measured_before: list[list[Try]] = []
        fitting = None
        for _ in range(MEASURES):
            aim = length / usual
            cost = (1 - LEFT) * work.left
            yield from work.take(self._fit(aim, about, worth), FITTED * cost)
            if not all(curve.tries for curve in self.curves):
                break
            objects = self._best(aim)
            estimated = max(attempt.deviation for attempt in objects)
            if objects in measured_before or estimated > aim:
                break
            measured_before.append(objects)
            items = [attempt.item for attempt in objects]
            measured = yield from work.take(self.by.level(items, 1), (1 - FITTED) * cost)
            if measured[1] <= length:
                fitting = objects, measured
                break
            usual = max(usual, measured[1] / max(estimated, BELOW * length))
            self._mend_left_out(aim)
        for curve in self.curves:
            curve.end_length(fitting[0] if fitting else ())
        return fitting

    def _fit(self, length: float, about: float, most: float) -> Generator[float, None, None]:
        """Try until each object's best try deviates by about `length`, as estimated.

        Yields the progress. Ends where that would take more than `most` triangles, as tries tell.
        """
        work = Workload(1)
        for k in range(MOST_TRIES):
            cost = (1 - LEFT_OF_ROUND) * work.left
            near = length * self.nearness
            plans = [curve.next_try(near, about) for curve in self.curves]
            if all(ratio is None for ratio in plans):
                missed = yield from work.take(self._miss_left_out(length))
                if k + 1 == MOST_TRIES or not missed:
                    return
                continue
            is_known = any(curve.known_tries for curve in self.curves)
            if is_known and self._triangles(plans, near) > most:
                return
            attempts = yield from work.take(self._try(plans), TRIED * cost)
            objects = [
                new or curve.best(near) for new, curve in zip(attempts, self.curves, strict=True)
            ]
            yield from work.take(self.by.read())
            steps = self.by.estimate([attempt.item for attempt in objects], length)
            estimate = yield from work.take(steps)
            work.did((1 - TRIED) * cost)
            for index, (new, curve) in enumerate(zip(attempts, self.curves, strict=True)):
                if new:
                    yield from work.take(self._note(index, new, estimate))
                    if not curve.dispensable:
                        curve.known_tries.append(new)

    def _triangles(self, plans: Sequence[float | None], length: float) -> float:
        """Return how many triangles the LOD has for which this is planned."""
        return sum(
            curve.best(length).triangles if ratio is None else ratio * curve.count
            for ratio, curve in zip(plans, self.curves, strict=True)
        )

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

    def _miss_left_out(self, length: float) -> Generator[float, None, bool]:
        """Estimate how far a LOD is from objects that it leaves out; mend it if that is too far.

        Returns whether it was.
        """
        if not any(curve.dispensable for curve in self.curves):
            return False
        objects = self._best(length)
        estimate = yield from self.by.estimate([attempt.item for attempt in objects], length)
        for number, (attempt, curve) in enumerate(zip(objects, self.curves, strict=True)):
            if curve.dispensable:
                yield from self._note(number, attempt, estimate)
        return self._mend_left_out(length)

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

    def _note(self, number: int, attempt: Try, estimate: DeviationEstimate) -> Iterator[float]:
        """Note what was estimated of the try of an object, and of each vertex of its source.

        Yields between steps.
        """
        curve = self.curves[number]
        attempt.deviation = estimate.deviations[number]
        if not curve.count:
            return
        if curve.evaluated is None:
            source = curve.source
            points = source.skin.place[0] if source.skin else source.geometry.points
            curve.evaluated = yield from run_in_thread(partial(self.by.vertices_at, number, points))
        attempt.away = estimate.away[number][curve.evaluated]

    def _try(self, plans: Sequence[float | None]) -> Generator[float, None, list[Try | None]]:
        """Make a try of the ratio that is planned for each source; yields the progress."""
        work = Workload(len(plans))
        attempts: list[Try | None] = []
        for ratio, curve in zip(plans, self.curves, strict=True):
            new = None
            if ratio is not None:
                made = yield from work.take(self.make(curve.source, ratio))
                new = Try(*made, ratio, curve.source.weight is not None)
                curve.tries.append(new)
            attempts.append(new)
            yield work.did(1)
        return attempts
