"""Costs, fitted to what renders took.

Non-negative least squares of relative errors (Lawson and Hanson, Solving Least Squares Problems,
1974, chapter 23).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

LEAST = 0.05  # of the largest value: a smaller one's error counts as a part of this


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
