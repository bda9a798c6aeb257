"""The search for the least tolerance that fits a budget: of LODs, of memory and of a shot plan."""

from collections.abc import Callable, Generator

import numpy as np

PRECISE = 1.002  # factor within which the least tolerance is found


def least_tolerance(
    fits: Callable[[float], bool], low: float, high: float
) -> Generator[None, None, float]:
    """Find by bisection the least tolerance from `low` on that fits: yield at each, return it.

    fits: whether a tolerance fits, in pixels; what a larger one takes is no more.
    low: pixels, above 0.
    high: pixels, which fit.
    """
    if fits(low):
        return low
    while high > PRECISE * low:
        yield
        middle = float(np.sqrt(low * high))
        if fits(middle):
            high = middle
        else:
            low = middle
    return high
