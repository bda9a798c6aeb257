"""Outlines are compared agent by agent, by whom two pictures show at each sample."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.validation.id_pictures import (
    NOBODY,
    OPENED,
    OUTLINE,
    PRESENCE,
    UNJUDGED,
    _around,
    _middles,
    judge,
)

ROWS, COLUMNS = 60, 90
GRID = np.mgrid[:ROWS, :COLUMNS]


def picture(*bodies):
    """Discs (agent, row, column, radius), the later ones before the others."""
    ids = np.full((ROWS, COLUMNS), NOBODY, np.int32)
    for agent, row, column, radius in bodies:
        ids[np.hypot(GRID[0] - row, GRID[1] - column) <= radius] = agent
    return ids


def judged(one, other, allowed=1.0, count=3):
    """Agent 0 is farthest, the last one nearest."""
    allowances = np.broadcast_to(np.float64(allowed), count)
    return judge(one, other, allowances, np.arange(count, 0, -1.0))


@pytest.mark.parametrize("by", [(0, 0), (0, 1), (2, 0), (3, 4), (-6, 2)])
def test_a_disc_that_moves_is_off_by_as_much(by):
    one, other = picture((1, 30, 40, 12)), picture((1, 30 + by[0], 40 + by[1], 12))
    found = judged(one, other)[1]
    assert found.by == OUTLINE and abs(found.error - np.hypot(*by)) <= 1
    assert found.error == judged(other, one)[1].error
    assert found.samples == found.other_samples == (one == 1).sum()


def test_one_that_is_missing_or_too_many_is_off_by_infinity_and_agent_0_is_one():
    for pair in ((picture((0, 30, 40, 12)), picture()), (picture(), picture((0, 30, 40, 12)))):
        found = judged(*pair)[0]
        assert found.error == np.inf and found.by == OUTLINE
        assert found.box == (18, 43, 28, 53)


@pytest.mark.parametrize("allowed", [0.1, 1.0])
def test_what_is_thinner_than_what_is_allowed_counts_for_nothing(allowed):
    one, other = picture((1, 30, 40, 12)), picture((1, 30, 40, 12))
    one[30, 52:80] = 1  # a stick
    # and some along the edges of all that it shows
    one[3:5, 9:85] = one[54:56, 9:85] = one[9:50, 4:6] = one[9:50, 84:86] = 1
    assert judged(one, other, allowed)[1].error == 0
    one[29:32, 52:80] = 1
    assert judged(one, other, allowed)[1].error > 25


def test_small_ones_are_judged_by_presence():
    one = picture((1, 30, 40, 2))
    assert (one == 1).sum() == 13
    for other, error in (
        (picture((1, 30, 42, 2)), 0),
        (picture((1, 30, 47, 2)), 3),
        (picture((1, 30, 60, 2)), np.inf),
        (picture(), np.inf),
    ):
        found = judged(one, other, 3.0)[1]
        assert (found.by, found.error) == (PRESENCE, error)
        assert judged(other, one, 3.0)[1].error == error
    few = np.full_like(one, NOBODY)
    few[5, 5:8] = 1
    assert judged(few, picture(), 3.0)[1].by == UNJUDGED
    assert judged(one, picture(), np.nan)[1].by == UNJUDGED


def test_who_is_covered_by_a_nearer_one_is_not_wrong_but_the_nearer_one_is():
    behind, before = (0, 30, 40, 9), (2, 30, 55, 9)
    wide = (2, 30, 55, 16)
    found = judged(picture(behind, before), picture(behind, wide))
    assert found[0].error == 0 and found[2].error == pytest.approx(7, abs=1)
    # and who comes to sight behind one that shrinks is not wrong either
    found = judged(picture(behind, wide), picture(behind, before))
    assert found[0].error == 0 and found[2].error == pytest.approx(7, abs=1)
    hidden = picture((2, 30, 40, 12))
    small = 0, 30, 40, 2
    found = judged(picture(small, (2, 30, 53, 10)), picture(small, (2, 30, 50, 12)), 3.0)
    assert found[0].by == PRESENCE and found[0].error == 0
    # one in front that is gone, however large the one behind it is
    found = judged(picture((0, 30, 40, 12), (2, 30, 40, 5)), picture((0, 30, 40, 12)))
    assert found[2].error == np.inf and found[0].error == 0
    assert judged(hidden, hidden)[2].error == 0


def test_opening_keeps_what_discs_cover_by_brute_force():
    random = np.random.default_rng(4)
    for radius in (1.0, 1.5, 2.5):
        mask = np.zeros((24, 30), bool)
        for row, column, size in random.uniform(0, 24, (5, 3)):
            mask |= (
                np.hypot(*(np.mgrid[:24, :30] - np.array([row, column])[:, None, None])) < size / 3
            )
        mask[3, :20] = True
        mask[[0, -1]] = mask[:, [0, -1]] = False
        reach = range(-3, 4)
        disc = [(a, b) for a in reach for b in reach if a * a + b * b <= radius * radius]
        alone = np.zeros_like(mask)
        alone[tuple(np.transpose(disc) + 5)] = True
        assert (_around(_middles(alone, radius), alone, radius) == alone).all()
        wanted = np.zeros_like(mask)
        for row, column in np.argwhere(mask):
            cells = np.array(disc) + (row, column)
            inside = (cells >= 0).all() and (cells < mask.shape).all()
            if inside and mask[tuple(cells.T)].all():
                wanted[tuple(cells.T)] = True
        assert (_around(_middles(mask, radius), mask, radius) == wanted).all()
    assert OPENED > 1
