"""The judges of benchmarks/lod_trial.py find what is known of balls and squares."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once
FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def judges(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import lod_judges

    yield lod_judges
    sys.modules.pop("lod_judges", None)


def prism(judges, sides: int, radius: float):
    """A prism without ends, 2 high, with corners on a cylinder."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-1.0, 1.0)])
    low = np.arange(sides)
    after = (low + 1) % sides
    upper = np.stack([low, after, after + sides], axis=1)
    lower = np.stack([low, after + sides, low + sides], axis=1)
    return judges.JudgedMesh(points, np.concatenate([upper, lower]))


def test_a_prism_of_few_sides_is_off_by_what_its_sides_cut_away(judges):
    fine = prism(judges, 96, 1.0)
    coarse = prism(judges, 6, 1.0)
    cut = 1 - np.cos(np.pi / 6)
    for one, other in ((fine, coarse), (coarse, fine)):
        most, _, _ = judges.divide(one, other, 0.0)
        assert 0.96 * cut < most < 1.001 * cut


def test_what_is_inside_does_not_count(judges):
    outer = prism(judges, 24, 1.0)
    inner = prism(judges, 24, 0.01)
    lids = [[begin, begin + k, begin + k + 1] for begin in (0, 24) for k in range(1, 23)]
    closed = judges.JudgedMesh(outer.points, np.concatenate([outer.triangles, lids]))
    inner.points[:, 2] *= 0.1
    both = judges.JudgedMesh(
        np.concatenate([closed.points, inner.points]),
        np.concatenate([closed.triangles, inner.triangles + len(closed.points)]),
    )
    assert closed.distances(inner.points).min() > 0.8
    assert judges.divide(both, closed, 0.0)[0] < 1e-4


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.77, 1.5])
def test_a_square_that_moves_is_off_by_as_much(judges, shift):
    square = np.array([[[0, 0], [100, 0], [100, 100]], [[0, 0], [100, 100], [0, 100]]], float)
    assert judges.shift([square, square + [shift, 0]]) == pytest.approx(shift, abs=1 / 32)
