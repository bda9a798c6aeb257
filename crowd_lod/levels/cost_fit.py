"""The costs of a machine, fitted to what renders on it took.

Non-negative least squares of relative errors (Lawson and Hanson, Solving Least Squares Problems,
1974, chapter 23).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import CrowdError
from .cost_model import NAMES, SECONDS, Work

LEAST = 0.05  # of the largest value: a smaller one's error counts as a part of this
RENDERS = 2  # for each coefficient, at least
MOST_OFF = 0.5  # root mean square of the relative errors of a fit that is taken


@dataclass(frozen=True)
class Fit:
    """What one of each count costs.

    costs: the count's name -> its cost, 0 or more.
    errors: (n,) float64, how far each fitted value is off, as a part of it.
    """

    costs: dict[str, float]
    errors: np.ndarray

    @property
    def off(self) -> float:
        """The root mean square of the errors."""
        return float(np.sqrt(np.mean(self.errors**2)))


def solve_non_negative(table: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the x (k,) >= 0 with the least squares of table (n, k) @ x - values (n,)."""
    x = np.zeros(table.shape[1])
    is_used = np.zeros(table.shape[1], bool)
    scale = np.linalg.norm(table, axis=0) + 1e-300
    for _ in range(100):
        gain = (table / scale).T @ (values - table @ x)
        gain[is_used] = -np.inf
        if gain.max() <= 1e-9 * np.linalg.norm(values):
            return x
        is_used[gain.argmax()] = True
        while True:
            trial = np.zeros_like(x)
            solution, *_ = np.linalg.lstsq(table[:, is_used] / scale[is_used], values, rcond=None)
            trial[is_used] = solution / scale[is_used]
            if (trial[is_used] > 0).all():
                break
            below = is_used & (trial <= 0)
            step = (x[below] / (x[below] - trial[below])).min()
            x += step * (trial - x)
            is_used &= x > 1e-15 * max(x.max(), 1e-300)
        x = trial
    return x


def fit_costs(counts: Mapping[str, np.ndarray], values: np.ndarray) -> Fit:
    """Fit what one of each count costs.

    counts: the count's name -> (n,) float64, how many there are.
    values: (n,) float64, what they cost together.
    """
    table = np.stack(list(counts.values()), axis=1).astype(np.float64)
    weight = 1 / np.maximum(values, LEAST * values.max())
    costs = solve_non_negative(table * weight[:, None], values * weight)
    return Fit(dict(zip(counts, costs.tolist(), strict=True)), (table @ costs - values) * weight)


def fit_seconds(engine: str, works: Sequence[Work], seconds: np.ndarray) -> Fit:
    """Fit the seconds of `engine` for one of each count of SECONDS[engine].

    A count that no render has keeps the developers' seconds.
    works: n renders, of numbers.
    seconds: (n,) float64, what each render takes beyond the scene without a crowd.
    CrowdError if the renders are too few, or do not follow from the counts.
    """
    counts = {
        name: np.array([getattr(work, name) for work in works], np.float64)
        for name in SECONDS[engine]
    }
    fitted = {name: column for name, column in counts.items() if column.any()}
    needed = RENDERS * len(fitted)
    usable = int((seconds > 0).sum())
    if usable < needed or not fitted:
        raise CrowdError(
            f"Only {usable} of {len(seconds)} renders took longer with a crowd than without, and "
            f"the costs of {NAMES[engine]} need {max(needed, 1)}: calibrate again with fewer "
            f"samples, when nothing else is at work on this machine."
        )
    fit = fit_costs(fitted, seconds)
    if fit.off > MOST_OFF:
        raise CrowdError(
            f"The times of the renders differ by {fit.off:.0%} from what their triangles and "
            f"agents explain, and may by {MOST_OFF:.0%}: calibrate again when nothing else is at "
            f"work on this machine."
        )
    return Fit(SECONDS[engine] | fit.costs, fit.errors)
