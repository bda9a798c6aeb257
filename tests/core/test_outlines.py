"""Outlines of cells: they enclose the cells, all of them and nothing else."""

import numpy as np
from crowd_lod_extension.crowd_lod.crowd.outlines import outlines
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays


def area(corners):
    x, y = corners.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) / 2


def inside(corners, x, y):
    """Whether each point is inside the line, by the count of its crossings with a ray to the east."""
    crossed = np.zeros(x.shape, int)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if x0 == x1:
            crossed += (x < x0) & (y > min(y0, y1)) & (y < max(y0, y1))
    return crossed % 2 == 1


masks = st.tuples(st.integers(1, 8), st.integers(1, 8)).flatmap(lambda shape: arrays(bool, shape))


@given(masks)
def test_outlines_hold_the_cells_and_nothing_else(cells):
    y, x = np.indices(cells.shape) + 0.5
    found = outlines(cells)
    covered = np.zeros(cells.shape, int)
    for each in found:
        assert area(each.outer) > 0 and all(area(hole) < 0 for hole in each.holes)
        here = inside(each.outer, x, y) & ~np.any([inside(hole, x, y) for hole in each.holes] or [np.zeros_like(cells)], axis=0)
        assert here.sum() == area(each.outer) + sum(map(area, each.holes))
        covered += here
    assert (covered == cells).all()


@given(masks)
def test_no_line_meets_itself_and_corners_are_turns(cells):
    for each in outlines(cells):
        for corners in (each.outer, *each.holes):
            assert len(np.unique(corners, axis=0)) == len(corners)
            steps = np.roll(corners, -1, axis=0) - corners
            assert ((steps != 0).sum(axis=1) == 1).all()
            assert ((steps[:, 0] != 0) != (np.roll(steps, -1, axis=0)[:, 0] != 0)).all()


def test_a_ring_that_closes_over_a_corner_has_a_hole_that_touches_it():
    cells = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 1, 0, 1], [0, 0, 1, 1]], bool)
    ring, apart = outlines(cells)
    assert len(ring.holes) == 1 and area(ring.outer) == 8 and area(ring.holes[0]) == -1
    assert not apart.holes and area(apart.outer) == 3


def test_no_cells_have_no_outline():
    assert outlines(np.zeros((3, 4), bool)) == []
