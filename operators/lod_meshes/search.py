"""Search for the LOD with the fewest triangles that deviates by a length at most.

Each object of a character has a curve of its own, triangles over deviation: one that is smooth, or that others hide,
takes few. All are tried at once, and measured together, as they are seen together.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.levels.lengths import NEAR_ENOUGH, read_curve
from ...crowd_lod.progress import share, standing
from .deviation import Measure
from .level_objects import discard
from .methods import LEAST
from .source_mesh import Source

ROUNDS = 5  # tries of a length, at most, before the whole is measured
REFINED = 2  # times that the whole is measured, once something fits
MOST_MEASURED = 4  # the same at most
AIMED = 0.97  # of a length that is aimed at
STEP = 1.08  # times the triangles, that a try must differ by from those before
MOST_STEP = 6.0  # times the triangles, that it may differ by
USUAL = 1.15  # times the deviation as estimated, that a bound is
OVERLOOKED = 1.3  # times the bound that is usual, from which on it is that of a place that the estimate did not look at
WIDE = 2.0  # times the triangles, within which a method does about as well against the other; and that a step is at most
WORSE = 1.3  # times the triangles, from which on a method is not tried
BETTER = 1.1  # times the triangles that Pose-Aware may take, which keeps UV seams
# A try up to SPOTTED times as far off as it should be, at FEW_SPOTS of its vertices, is made AGAIN so often with as many
# triangles, and these vertices count HEAVIER each time.
SPOTTED, FEW_SPOTS, AGAIN, HEAVIER = 1.4, 0.01, 2, 4.0
METHODS = "POSE_AWARE", "DECIMATE"

Figures = tuple[float, float, float, float]  # see Measure.level
Make = Callable[[Source, float, str], Generator[Any, None, tuple[bpy.types.Object, int, int]]]


@dataclass(eq=False)
class Try:
    """An object of a LOD that was made.

    item: it; vertices, triangles: how many it has; method, ratio: how it was made; deviation: meters, as estimated.
    spots: (n,) bool, the source's vertices where it is farther off than it should.
    """

    item: bpy.types.Object
    vertices: int
    triangles: int
    method: str
    ratio: float
    deviation: float = 0.0
    spots: np.ndarray | None = None


@dataclass
class Curve:
    """What is known of an object's LODs.

    source: the object's; known: each method's tries; tries: of this length, whose objects are still there.
    evaluated: (n,) which vertex of the evaluated object each of the source's is; None before that is asked for.
    """

    source: Source
    known: dict[str, list[Try]] = field(default_factory=lambda: {method: [] for method in METHODS})
    tries: list[Try] = field(default_factory=list)
    evaluated: np.ndarray | None = None

    @property
    def count(self) -> int:
        """How many triangles the source has."""
        return len(self.source.geometry[1]) if self.source.mesh else 0

    def ratio_for(self, method: str, length: float, about: float) -> float:
        """Return the part of the triangles with which the method's LOD deviates by `length`, in meters.

        about: that part if nothing is known.
        """
        known = [(max(attempt.deviation, length / MOST_STEP), attempt.ratio) for attempt in self.known[method]]
        ratio = float(read_curve([length], known, -1.0)[0]) if known else about
        return min(max(ratio, LEAST / max(self.count, 1)), 1.0)

    def best(self, length: float) -> Try:
        """Return the try of fewest triangles that deviates by `length` at most, else the nearest."""
        fitting = [attempt for attempt in self.tries if attempt.deviation <= length]
        if not fitting:
            return min(self.tries, key=lambda attempt: attempt.deviation)
        return min(fitting, key=lambda attempt: attempt.triangles * (BETTER if attempt.method == "DECIMATE" else 1.0))

    def weigh_spots(self, length: float) -> Try | None:
        """Let the places count more where the last try is too far off, if they are few, and return that try; else None."""
        last = self.tries[-1]
        if last.method != "POSE_AWARE" or not length < last.deviation < SPOTTED * length or last.spots is None:
            return None
        if not 0 < last.spots.mean() < FEW_SPOTS or sum(attempt.ratio == last.ratio for attempt in self.tries) > AGAIN:
            return None
        triangles = self.source.geometry[1]
        around = np.unique(triangles[last.spots[triangles].any(axis=1)])
        weight = np.ones(len(last.spots)) if self.source.weight is None else self.source.weight.copy()
        weight[around] *= HEAVIER
        self.source.weight = weight
        return last

    def next_tries(self, methods: Sequence[str], length: float, about: float) -> list[tuple[str, float]]:
        """Return (method, ratio) of what to try next; [] if the best try will do."""
        if not self.count:
            return [] if self.tries else [(methods[0], 1.0)]
        if self.tries and NEAR_ENOUGH * length <= self.best(length).deviation <= length:
            return []
        if self.tries and (spotted := self.weigh_spots(length)):
            return [(spotted.method, spotted.ratio)]
        ratios = {method: self.ratio_for(method, length, about) for method in methods}
        least = min(ratios.values())
        unknown = [method for method in methods if not self._known_near(method, ratios[method])]
        promising = [method for method in unknown if ratios[method] <= WORSE * least]
        tries = promising or [min(ratios, key=lambda method: ratios[method] * (BETTER if method == "DECIMATE" else 1.0))]
        return [(method, ratio) for method in tries if (ratio := self._apart(method, ratios[method], length))]

    def _known_near(self, method: str, ratio: float) -> bool:
        """Return whether a try of the method with about the ratio is known."""
        return any(ratio / WIDE < attempt.ratio < ratio * WIDE for attempt in self.known[method])

    def _apart(self, method: str, ratio: float, length: float) -> float:
        """Return `ratio`, or a greater one if it was tried; 0 if there is nothing to try."""
        tried = [attempt.ratio for attempt in self.tries if attempt.method == method]
        if any(ratio / STEP < other < ratio * STEP for other in tried):
            if self.best(length).deviation <= length or max(tried) == 1.0:
                return 0.0
            return min(1.0, max(tried) * min(max(self.best(length).deviation / length, STEP**2), WIDE))
        return ratio


class Search:
    """The search of one character's LODs, which learns from each.

    sources: the character's objects. method: AUTO, POSE_AWARE or DECIMATE. make: makes an object of a source with a
    ratio and a method, and yields between its steps. by: measures.
    """

    def __init__(self, sources: Sequence[Source], method: str, make: Make, by: Measure):
        self.make, self.by = make, by
        self.methods = METHODS if method == "AUTO" else (method,)
        self.curves = [Curve(source) for source in sources]
        self.times = USUAL  # a LOD's bound over its deviation as estimated

    def find(self, length: float, about: float) -> Generator[float, None, tuple[list[Try], Figures]]:
        """Find the LOD of fewest triangles whose bound is `length` meters at most; yields the progress.

        about: the part of the triangles that it takes, as far as is known.
        Returns its objects and what Measure.level says of them. Where none fits, these are the nearest that were found.
        """
        found: list[tuple[bool, float, list[Try], Figures]] = []
        for k in range(MOST_MEASURED):
            yield from share(self._fit(AIMED * length / self.times, about), k / MOST_MEASURED, (k + 0.7) / MOST_MEASURED)
            objects = [curve.best(AIMED * length / self.times) for curve in self.curves]
            if any(objects == earlier for _, _, earlier, _ in found):
                break
            measured = yield from share(
                self.by.level([attempt.item for attempt in objects], 1), (k + 0.7) / MOST_MEASURED, (k + 1) / MOST_MEASURED
            )
            bound, deviation = measured[1], max(attempt.deviation for attempt in objects)
            fits = bound <= length
            found.append((not fits, sum(attempt.triangles for attempt in objects) if fits else bound, objects, measured))
            if 0 < bound < OVERLOOKED * self.times * deviation:
                self.times = (self.times * bound / deviation) ** 0.5
            # what was measured counts from now on, not what was estimated
            worst = max(objects, key=lambda attempt: attempt.deviation)
            worst.deviation = bound / self.times
            if NEAR_ENOUGH * length <= bound <= length or (k + 1 >= REFINED and any(not misses for misses, *_ in found)):
                break
        _, _, objects, measured = min(found, key=lambda each: each[:2])
        for curve in self.curves:
            curve.source.weight = None
            discard([attempt.item for attempt in curve.tries if attempt not in objects])
            curve.tries = []
        return objects, measured

    def _fit(self, length: float, about: float) -> Generator[float, None, None]:
        """Try until each object's best try deviates by about `length`, as estimated; yields the progress."""
        for k in range(ROUNDS):
            wanted = [curve.next_tries(self.methods, length, about) for curve in self.curves]
            # each object by one method at a time
            for number in range(max(map(len, wanted))):
                made = yield from self._try([tries[number : number + 1] for tries in wanted], k / ROUNDS)
                objects = [own[0] if own else curve.best(length) for own, curve in zip(made, self.curves, strict=True)]
                yield from standing(self.by.read(), k / ROUNDS)
                estimate = self.by.estimate([attempt.item for attempt in objects], length)
                for index, (own, curve) in enumerate(zip(made, self.curves, strict=True)):
                    for attempt in own:
                        attempt.deviation = estimate.deviations[index]
                        attempt.spots = self._on_source(index, estimate.spots[index])
                        curve.known[attempt.method].append(attempt)
            if not any(wanted):
                return

    def _on_source(self, number: int, spots: np.ndarray) -> np.ndarray | None:
        """Return which vertices of the object's source are among the `spots` of the object as evaluated, (n,) bool."""
        curve = self.curves[number]
        if not curve.count:
            return None
        if curve.evaluated is None:
            source = curve.source
            curve.evaluated = self.by.vertices_at(number, source.skin.place[0] if source.skin else source.geometry[0])
        return np.isin(curve.evaluated, spots)

    def _try(self, wanted: list[list[tuple[str, float]]], progress: float) -> Generator[float, None, list[list[Try]]]:
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
