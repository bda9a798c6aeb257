"""The fit of costs to renders."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from cost_fit import fit_costs, solve_non_negative


def test_no_cost_is_negative_and_none_other_fits_better():
    random = np.random.default_rng(5)
    for _ in range(20):
        table = random.random((30, 5))
        values = table @ random.normal(0.5, 1, 5)
        found = solve_non_negative(table, values)
        assert (found >= 0).all()
        # the conditions of Karush, Kuhn and Tucker
        gain = table.T @ (values - table @ found)
        assert (gain <= 1e-8).all() and np.abs(gain[found > 0]).max(initial=0) < 1e-8


def test_what_costs_little_counts_as_a_part_of_the_dearest():
    fit = fit_costs({"triangles": np.array([1e3, 1e6])}, np.array([0.0, 2.0]))
    assert fit.costs["triangles"] == pytest.approx(2e-6, rel=1e-3)
    assert np.abs(fit.errors).max() < 0.05
