"""The fit of a machine's costs to renders."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.cost_fit import (
    fit_costs,
    fit_seconds,
    solve_non_negative,
)
from crowd_lod_extension.crowd_lod.levels.cost_model import SECONDS, Costs, Work, price


def renders(random, count):
    """Works of renders of all sizes."""
    splits = np.random.default_rng(6)
    return [
        Work(
            posed=10 ** random.uniform(4, 6),
            unique=10 ** random.uniform(4, 6),
            split=10 ** splits.uniform(4, 6),
            instances=10 ** random.uniform(1, 5),
            instanced=10 ** random.uniform(5, 7),
            rigs=random.integers(1, 100),
            rays=10 ** random.uniform(4, 6),
            drawn_triangles=10 ** random.uniform(5, 8),
        )
        for _ in range(count)
    ]


@pytest.mark.parametrize("engine", SECONDS)
def test_a_fit_finds_the_seconds_of_a_machine(engine):
    random = np.random.default_rng(3)
    true = {name: cost * random.uniform(0.1, 10) for name, cost in SECONDS[engine].items()}
    works = renders(random, 60)
    machine = Costs(engine, true, "a test")
    seconds = np.array([price(work, machine).seconds for work in works])
    exact = fit_seconds(engine, works, seconds)
    true["images"] = SECONDS[engine]["images"]  # no render has any
    assert exact.costs == pytest.approx(true, rel=1e-6)
    assert exact.off < 1e-9
    noisy = fit_seconds(engine, works, seconds * random.uniform(0.95, 1.05, len(works)))
    again = np.array([price(work, Costs(engine, noisy.costs, "a test")).seconds for work in works])
    assert np.abs(again / seconds - 1).max() < 0.15
    assert min(noisy.costs.values()) >= 0 and 0.01 < noisy.off < 0.05


def test_renders_that_do_not_tell_the_costs_are_refused():
    random = np.random.default_rng(4)
    works = renders(random, 12)
    with pytest.raises(CrowdError, match=r"Only 9 of 12 renders took longer .* Cycles need 12"):
        fit_seconds("CYCLES", works, np.repeat([1.0, -0.1], [9, 3]))
    with pytest.raises(CrowdError, match="Only 3 of 3 renders"):
        fit_seconds("CYCLES", works[:3], np.ones(3))
    with pytest.raises(CrowdError, match=r"differ by \d+% from what their triangles"):
        fit_seconds("CYCLES", renders(random, 16), 10 ** random.uniform(-2, 2, 16))


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
