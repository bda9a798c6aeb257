"""The height at which a character stands, by its soles."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.bounds import ground_of, sole_of

SIDES = [
    (0, 2, 1),
    (0, 3, 2),
    (4, 5, 6),
    (4, 6, 7),
    (0, 1, 5),
    (0, 5, 4),
    (1, 2, 6),
    (1, 6, 5),
    (2, 3, 7),
    (2, 7, 6),
    (3, 0, 4),
    (3, 4, 7),
]


def boxes(*ends):
    """(points, triangles) of boxes, each from its least to its greatest corner."""
    points = []
    triangles = []
    for k, (low, high) in enumerate(ends):
        square = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        points += [(x, y, z) for z in (low[2], high[2]) for x, y in square]
        triangles += [[8 * k + corner for corner in side] for side in SIDES]
    return np.array(points, float), np.array(triangles)


LEGS = ((-0.05, 0.1, 0), (0.2, 0.2, 0.9)), ((-0.05, -0.2, 0), (0.2, -0.1, 0.9))
BODY = (*LEGS, ((-0.1, -0.25, 0.9), (0.15, 0.25, 1.8)))


@pytest.mark.parametrize("size", [0.01, 1, 1000])
@pytest.mark.parametrize("below", [0.0, 0.16, 0.4])
def test_a_sword_in_the_hand_lifts_nobody(size, below):
    sword = ((0.3, 0.3, -below), (0.32, 0.35, 0.9))
    points, triangles = boxes(*BODY, sword)
    assert sole_of(size * points, triangles) == pytest.approx(0, abs=1e-9 * size)


def test_who_stands_on_the_tip_of_a_toe_is_not_lowered_to_the_heels():
    heels = [((x, y, 0.15), high) for (x, y, _), high in LEGS]
    toe = ((-0.05, 0.1, 0), (0, 0.12, 0.15))
    assert sole_of(*boxes(*heels, BODY[2], toe)) == 0


def test_who_stands_on_legs_without_soles_stands_on_their_lowest_point():
    points, triangles = boxes(*BODY)
    open_legs = triangles[(points[triangles][:, :, 2] > 0).any(axis=1)]
    assert sole_of(points - (0, 0, 3), open_legs) == -3


def test_a_robe_over_the_feet_is_no_sole():
    robe = ((-0.4, -0.4, 0.1), (0.4, 0.4, 1.2))
    assert sole_of(*boxes(*BODY, robe)) == pytest.approx(0, abs=1e-9)


def test_points_alone_stand_on_the_lowest():
    points = np.array([(0, 0, 2.0), (1, 0, 1.0)])
    assert sole_of(points, np.empty((0, 3), int)) == 1
    assert sole_of(points[:0], np.empty((0, 3), int)) == np.inf


def test_the_ground_is_where_feet_are_planted():
    walk = [0.0] * 18 + [-0.067, -0.06, -0.04] * 2
    run = [0.0] * 8 + [0.1, 0.12, 0.1] * 4
    assert ground_of(np.array(walk)) == ground_of(np.array(run)) == 0
