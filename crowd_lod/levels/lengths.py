"""Deviations that a shot allows its LODs, and curves through what is known of these."""

from collections.abc import Iterable, Sequence

import numpy as np

from .assignment import MOST_LEVELS
from .selection import View

MOST_LENGTHS = MOST_LEVELS - 1
APART = 1.25  # times the length before, at least: with less, next to no triangles are saved
COARSEST = 0.25  # of the radius: a LOD that deviates more is a few triangles whatever the length
# of the nearest agent's length: where shading counts, LODs that are so much finer may be asked for
DARKER = 0.25
# of a length, by which a LOD deviates that was made for another: it takes few triangles more than
# the length needs
NEAR_ENOUGH = 0.87
DIGITS = 4  # of a length, so that it is the same the next time


def allowed_lengths(
    views: Sequence[View],
    radius: float,
    tolerance: float,
    finest: float,
    higher: bool = False,
    finer: float = 1.0,
) -> list[float]:
    """Return deviations that agents allow, in meters, rising: from the nearest agent's to the
    farthest's.

    They are a geometric series, of at most MOST_LENGTHS.

    radius: meters, of the agents' bounding sphere.
    tolerance: pixels.
    finest: meters; a LOD that deviates less saves nothing.
    higher: whether also to return those that a higher tolerance allows.
    finer: part of the nearest agent's length, with which they begin.
    """
    ends = np.array([_lengths(view, radius, tolerance) for view in views])
    most = COARSEST * radius
    low = float(np.clip(finer * ends[:, 0].min(), min(finest, most), most))
    high = most if higher else float(np.clip(ends[:, 1].max(), low, most))
    count = min(MOST_LENGTHS, int(np.log(high / low) / np.log(APART)) + 1)
    return [_rounded_down(length) for length in np.geomspace(low, high, count)]


def in_gaps(lengths: Sequence[float], given_lengths: Sequence[float]) -> list[float]:
    """Return those `lengths`, meters, that lie farthest from deviations of LODs that are given.

    With these they are at most MOST_LENGTHS.
    """
    left = sorted(lengths)
    away = {
        length: min(abs(np.log(length / other)) for other in given_lengths)
        for length in left
        if given_lengths
    }
    while len(left) + len(given_lengths) > MOST_LENGTHS:
        left.remove(min(left, key=lambda length: away[length]))
    return left


def _lengths(view: View, radius: float, tolerance: float) -> tuple[float, float]:
    """Return what shows `tolerance` pixels of the nearest and of the farthest agent, in meters."""
    pixel = tolerance / view.camera.pixels_per_unit
    if view.camera.kind == "ORTHO":
        return pixel, pixel
    return pixel * max(view.nearest - radius, 0.0), pixel * max(view.farthest - radius, 0.0)


def _rounded_down(length: float) -> float:
    """Return `length` with DIGITS digits, no larger."""
    step = 10.0 ** (np.floor(np.log10(length)) + 1 - DIGITS)
    return float(f"{np.floor(length / step * (1 + 1e-12)) * step:.{DIGITS}g}")


def read_curve(
    at: Sequence[float], pairs: Iterable[tuple[float, float]], power: float
) -> np.ndarray:
    """Return values (k,) at `at` of the falling or rising curve through the points `pairs`.

    It is linear between the points' logarithms. Beyond the first and the last it goes as x **
    power. Where points contradict the sign of `power`, the least value counts. `pairs` has one
    point at least; all is positive.
    """
    x, y = np.log(np.array(sorted(pairs))).T
    y = np.minimum.accumulate(y) if power < 0 else np.minimum.accumulate(y[::-1])[::-1]
    x, first = np.unique(x, return_index=True)
    y = y[np.append(first[1:], len(y)) - 1] if power < 0 else y[first]
    x_at = np.log(np.asarray(at, np.float64))
    beyond = np.minimum(x_at - x[0], 0) + np.maximum(x_at - x[-1], 0)
    return np.exp(np.interp(x_at, x, y) + power * beyond)
