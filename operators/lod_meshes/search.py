"""Search for the LOD with the fewest triangles that deviates by a length at most.

Each object of a character has a curve of its own, triangles over deviation: one that is smooth, or
that others hide, takes few. All are tried at once, and measured together, as they are seen
together.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.levels.lengths import NEAR_ENOUGH, read_curve
from ...crowd_lod.progress import share, standing
from .deviation import Estimate, Measure
from .dispensable import find_dispensable
from .level_objects import discard
from .methods import LEAST
from .source_mesh import Source

ROUNDS = 5  # tries of a length, at most, before the whole is measured
REFINED = 2  # times that the whole is measured, once something fits
MOST_MEASURED = 4  # the same at most
SAFE = 1.3  # times as near as is estimated to do, a LOD is tried last where none fits
STEP = 1.08  # times the triangles, that a try must differ by from those before
MOST_STEP = 6.0  # times the triangles, that it may differ by
USUAL = 1.08  # times the deviation as estimated, that a bound is
# times the triangles, within which a method does about as well against the other; and that a step
# is at most
WIDE = 2.0
WORSE = 1.3  # times the triangles, from which on a method is not tried
BETTER = 1.1  # times the triangles that Pose-Aware may take, which keeps UV seams
# A try that is too far off at FEW_SPOTS of its vertices alone is made AGAIN so often with as many
# triangles, and these vertices count HEAVIER each time. Where more are, what is won at them is lost
# beside them.
FEW_SPOTS, AGAIN, HEAVIER = 0.003, 2, 32.0
# of the deviation before, that is left once it was made again; with more, it is not made once more
WON = 0.95
# of the length, that objects may deviate by which stand in for those left out, at least
NEAREST = 0.1
METHODS = "POSE_AWARE", "DECIMATE"

Figures = tuple[float, float, float, float]  # see Measure.level
Make = Callable[[Source, float, str], Generator[Any, None, tuple[bpy.types.Object, int, int]]]


@dataclass(eq=False)
class Try:
    """An object of a LOD that was made.

    item: it; vertices, triangles: how many it has; method, ratio: how it was made; deviation:
    meters, as estimated.
    away: (n,) meters, that of each vertex of the source; poses: in how many.
    """

    item: bpy.types.Object
    vertices: int
    triangles: int
    method: str
    ratio: float
    deviation: float = 0.0
    away: np.ndarray = field(default_factory=lambda: np.zeros(1))
    poses: int = 0

    @property
    def reachable(self) -> float:
        """Return the deviation but for a few spots, if these can be mended: with as many
        triangles.
        """
        most = (
            float(np.quantile(self.away, 1 - FEW_SPOTS)) if self.method == "POSE_AWARE" else np.inf
        )
        return min(most, self.deviation)


@dataclass
class Curve:
    """What is known of an object's LODs.

    source: the object's; known: each method's tries; tries: of this length, whose objects are still
    there.
    dispensable: whether LODs of this length leave the object out.
    evaluated: (n,) which vertex of the evaluated object each of the source's is; None before that
    is asked for.
    """

    source: Source
    known: dict[str, list[Try]] = field(default_factory=lambda: {method: [] for method in METHODS})
    tries: list[Try] = field(default_factory=list)
    dispensable: bool = False
    evaluated: np.ndarray | None = None

    @property
    def count(self) -> int:
        """How many triangles the source has."""
        return len(self.source.geometry[1]) if self.source.mesh else 0

    def ratio_for(self, method: str, length: float, about: float) -> float:
        """Return the part of the triangles with which the method's LOD deviates by `length`, in
        meters.

        about: that part if nothing is known.
        """
        least = length / MOST_STEP
        tries = [
            attempt for attempt in self.known[method] if attempt.deviation > least
        ] or self.known[method]
        known = [(max(attempt.reachable, least), attempt.ratio) for attempt in tries]
        ratio = float(read_curve([length], known, -1.0)[0]) if known else about
        if known:  # the whole itself would tell nothing: at most half the way there
            ratio = min(ratio, max(part for _, part in known) ** 0.5)
        return min(max(ratio, LEAST / max(self.count, 1)), 1.0)

    def best(self, length: float) -> Try:
        """Return the try of fewest triangles that deviates by `length` at most, else the
        nearest.
        """
        fitting = [attempt for attempt in self.tries if attempt.deviation <= length]
        if not fitting:
            return min(self.tries, key=lambda attempt: attempt.deviation)
        return min(
            fitting,
            key=lambda attempt: (
                attempt.triangles * (BETTER if attempt.method == "DECIMATE" else 1.0)
            ),
        )

    def weigh_spots(self, length: float) -> list[tuple[str, float]]:
        """Let the few places count more where the coarsest try that may be mended is too far off.

        Returns (method, ratio) of that try, to be made again; [] if there is none.
        """
        mended = [
            attempt
            for attempt in self.tries
            if attempt.method == "POSE_AWARE" and attempt.reachable <= length
        ]
        deviations: dict[float, list[float]] = {}
        for attempt in self.tries:
            if attempt.method == "POSE_AWARE":
                deviations.setdefault(attempt.ratio, []).append(attempt.deviation)
        last = {attempt.ratio: attempt for attempt in mended}
        weight = (
            np.ones(len(self.source.geometry[0]))
            if self.source.weight is None
            else self.source.weight
        )
        triangles = self.source.geometry[1]
        for ratio in sorted(last):
            spots = (last[ratio].away > length) & (weight < HEAVIER**2)
            *before, now = deviations[ratio]
            is_won = not before or now <= WON * before[-1]
            if spots.any() and is_won and len(before) < AGAIN:
                around = np.unique(triangles[spots[triangles].any(axis=1)])
                self.source.weight = weight.copy()
                self.source.weight[around] *= HEAVIER
                return [("POSE_AWARE", ratio)]
        return []

    def next_tries(
        self, methods: Sequence[str], length: float, about: float
    ) -> list[tuple[str, float]]:
        """Return (method, ratio) of what to try next; [] if the best try will do."""
        if self.dispensable or not self.count:
            return [] if self.tries else [(methods[0], 0.0 if self.dispensable else 1.0)]
        if self.tries and NEAR_ENOUGH * length <= self.best(length).deviation <= length:
            return []
        ratios = {method: self.ratio_for(method, length, about) for method in methods}
        least = min(ratios.values())
        unknown = [method for method in methods if not self._known_near(method, ratios[method])]
        promising = [method for method in unknown if ratios[method] <= WORSE * least]
        best = min(
            ratios, key=lambda method: ratios[method] * (BETTER if method == "DECIMATE" else 1.0)
        )
        if not promising and best == "POSE_AWARE" and (spotted := self.weigh_spots(length)):
            return spotted
        tries = promising or [best]
        return [
            (method, ratio)
            for method in tries
            if (ratio := self._apart(method, ratios[method], length))
        ]

    def _known_near(self, method: str, ratio: float) -> bool:
        """Return whether a try of the method with about the ratio is known."""
        return any(ratio / WIDE < attempt.ratio < ratio * WIDE for attempt in self.known[method])

    def _apart(self, method: str, ratio: float, length: float) -> float:
        """Return `ratio`, or a greater one if it was tried; 0 if there is nothing to try."""
        tried = [attempt.ratio for attempt in self.tries if attempt.method == method]
        if any(ratio / STEP < other < ratio * STEP for other in tried):
            if self.best(length).deviation <= length or max(tried) == 1.0:
                return 0.0
            nearest = min(attempt.reachable for attempt in self.tries)
            return min(1.0, max(tried) * min(max(nearest / length, STEP**2), WIDE))
        return ratio


class Search:
    """The search of one character's LODs, which learns from each.

    sources: the character's objects. method: AUTO, POSE_AWARE or DECIMATE. make: makes an object of
    a source with a ratio and a method, and yields between its steps. by: measures.
    """

    def __init__(self, sources: Sequence[Source], method: str, make: Make, by: Measure):
        self.make, self.by = make, by
        self.methods = METHODS if method == "AUTO" else (method,)
        self.curves = [Curve(source) for source in sources]
        self.nearness = 1.0  # see NEAREST

    def find(
        self, length: float, about: float
    ) -> Generator[float, None, tuple[list[Try], Figures]]:
        """Find the LOD of fewest triangles whose bound is `length` meters at most; yields the
        progress.

        about: the part of the triangles that it takes, as far as is known.
        Returns its objects and what was measured of them. Where none fits, these are the
        character's own.
        """
        fitting: list[tuple[int, list[Try], Figures]] = []
        before: list[list[Try]] = []
        yield from self._leave_out(length / USUAL)
        for k in range(MOST_MEASURED):
            last = k + 1 == MOST_MEASURED and not fitting
            aim = length / (USUAL * (SAFE if last else 1.0))
            yield from share(self._fit(aim, about), k / MOST_MEASURED, (k + 0.7) / MOST_MEASURED)
            objects = self._best(aim)
            if objects in before:
                continue
            before.append(objects)
            measured = yield from share(
                self._measure(objects, length), (k + 0.7) / MOST_MEASURED, (k + 1) / MOST_MEASURED
            )
            bound = measured[1]
            if bound <= length:
                fitting.append((sum(attempt.triangles for attempt in objects), objects, measured))
            if NEAR_ENOUGH * length <= bound <= length or (k + 1 >= REFINED and fitting):
                break
            self._learn(objects, length / USUAL)
            self._mend_left_out(length / USUAL)
        if not fitting:
            objects = yield from self._whole()
            measured = yield from standing(self._measure(objects, length), 1.0)
            fitting.append((0, objects, measured))
        _, objects, measured = min(fitting, key=lambda candidate: candidate[0])
        for curve in self.curves:
            curve.source.weight = None
            discard([attempt.item for attempt in curve.tries if attempt not in objects])
            curve.tries = []
        return objects, measured

    def _measure(self, objects: list[Try], length: float) -> Generator[float, None, Figures]:
        """Measure a LOD, in frames between the poses as well if it fits `length` in these; yields
        the progress.
        """
        items = [attempt.item for attempt in objects]
        measured = yield from share(self.by.level(items, 1), 0.0, 0.5)
        if measured[1] <= length:
            (measured,) = yield from share(self.by.look_between([items], [measured]), 0.5, 1.0)
        return measured

    def _learn(self, objects: list[Try], length: float) -> None:
        """Note what a whole measure says of a LOD: its worst place may be one that no estimate
        looks at.
        """
        estimate = self.by.estimate([attempt.item for attempt in objects], length)
        deviation, number, vertices = self.by.worst_vertices()
        estimate.deviations[number] = max(estimate.deviations[number], deviation)
        estimate.away[number][vertices] = np.maximum(estimate.away[number][vertices], deviation)
        self._note_all(objects, estimate)

    def _note_all(self, objects: list[Try], estimate: Estimate) -> None:
        """Note what was estimated of a LOD in more poses than before; what is coarser is no
        nearer.
        """
        for index, (attempt, curve) in enumerate(zip(objects, self.curves, strict=True)):
            self._note(index, attempt, estimate)
            for other in curve.tries:
                if other.method == attempt.method and other.ratio < attempt.ratio:
                    other.deviation = max(other.deviation, attempt.deviation)

    def _whole(self) -> Generator[float, None, list[Try]]:
        """Make the objects of the character itself, as no LOD fits."""
        made = yield from self._try([[(self.methods[0], 1.0)] for _ in self.curves], 1.0)
        return [attempt for (attempt,) in made]

    def _fit(self, length: float, about: float) -> Generator[float, None, None]:
        """Try until each object's best try deviates by about `length`, as estimated; yields the
        progress.
        """
        for k in range(ROUNDS):
            near = length * self.nearness
            wanted = [curve.next_tries(self.methods, near, about) for curve in self.curves]
            # each object by one method at a time
            for number in range(max(map(len, wanted))):
                made = yield from self._try(
                    [tries[number : number + 1] for tries in wanted], k / ROUNDS
                )
                objects = [
                    own[0] if own else curve.best(near)
                    for own, curve in zip(made, self.curves, strict=True)
                ]
                yield from standing(self.by.read(), k / ROUNDS)
                estimate = self.by.estimate([attempt.item for attempt in objects], length)
                for index, (own, curve) in enumerate(zip(made, self.curves, strict=True)):
                    for attempt in own:
                        self._note(index, attempt, estimate)
                        if not curve.dispensable:
                            curve.known[attempt.method].append(attempt)
            if any(wanted):
                continue
            objects = self._best(length)
            is_known = all(attempt.poses == len(self.by.frames) for attempt in objects)
            leaves_out = any(curve.dispensable for curve in self.curves)
            if is_known and not leaves_out:
                return
            self._note_all(objects, self.by.estimate([attempt.item for attempt in objects], length))
            if not self._mend_left_out(length) and is_known:
                return

    def _leave_out(self, length: float) -> Iterator[float]:
        """Find which objects LODs of the length may leave out."""
        yield from standing(self.by.read(), 0.0)
        if len(self.curves) > 1:
            self.nearness = 1.0
            dispensable = find_dispensable(self.by.character, length)
            for curve, is_dispensable in zip(self.curves, dispensable, strict=True):
                curve.dispensable = bool(is_dispensable) and curve.count > 0

    def _best(self, length: float) -> list[Try]:
        """Return the best try of each object for a LOD that deviates by `length` at most."""
        return [curve.best(length * self.nearness) for curve in self.curves]

    def _mend_left_out(self, length: float) -> bool:
        """Mend a LOD that is farther than `length` from objects that it leaves out.

        The worst of these come back, and the other objects come near enough for the rest: as many
        come back as takes the fewest triangles, about. Returns whether there was anything to mend.
        """
        left_out = [curve for curve in self.curves if curve.dispensable and curve.tries]
        left_out.sort(key=lambda curve: -curve.tries[0].deviation)
        deviations = np.array([curve.tries[0].deviation for curve in left_out] + [0.0])
        count = int((deviations > length).sum())
        if not count:
            return False
        others = [
            attempt for attempt in self._best(length) if attempt.triangles and attempt.deviation
        ]
        off = max((attempt.deviation for attempt in others), default=0.0)
        nearness = np.ones(count + 1)
        nearness[:count] = (off + length - deviations[:count]) / max(off, 1e-9 * length)
        triangles = sum(attempt.triangles for attempt in others)
        costs = np.arange(count + 1) * LEAST + triangles / nearness.clip(1e-9)
        costs[self.nearness * nearness < NEAREST] = np.inf
        back = int(costs.argmin())
        self.nearness *= float(nearness[back])
        for curve in left_out[:back]:
            curve.dispensable = False
            discard([attempt.item for attempt in curve.tries])
            curve.tries = []
        return True

    def _note(self, number: int, attempt: Try, estimate: Estimate) -> None:
        """Note what was estimated of the try of an object, and of each vertex of its source."""
        curve = self.curves[number]
        attempt.poses = len(self.by.frames)
        attempt.deviation = estimate.deviations[number]
        if not curve.count:
            return
        if curve.evaluated is None:
            source = curve.source
            curve.evaluated = self.by.vertices_at(
                number, source.skin.place[0] if source.skin else source.geometry[0]
            )
        attempt.away = estimate.away[number][curve.evaluated]

    def _try(
        self, wanted: list[list[tuple[str, float]]], progress: float
    ) -> Generator[float, None, list[list[Try]]]:
        """Make the objects `wanted`, one or none of each source; yields `progress`."""
        made = []
        for tries, curve in zip(wanted, self.curves, strict=True):
            own = []
            for method, ratio in tries:
                steps = self.make(curve.source, ratio, method)
                item, vertices, triangles = yield from standing(steps, progress)
                own.append(Try(item, vertices, triangles, method, ratio))
            curve.tries += own
            made.append(own)
        return made
