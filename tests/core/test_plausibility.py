"""What is implausible of a crowd, by arrays alone."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.validation import plausibility as judge


def test_giants_and_dwarfs_are_found_and_people_are_not():
    assert judge.check_heights(np.array([1.75, 78.0, 0.002, 0.0, 2.4])).tolist() == [1, 2]
    assert not len(judge.check_heights(np.array([1.1, 1.9, 0.0])))


@pytest.mark.parametrize(
    "speeds, median",
    [([5.0, 5.2, 0], 5.1), ([0.03, 0.0125], 0.03), ([0, 0], 0), ([1.3, 0], None), ([], None)],
)
def test_speeds_that_people_do_not_walk_at_are_found(speeds, median):
    assert judge.check_speeds(np.array(speeds), judge.RUNS) == median


def test_a_speed_is_that_of_who_walks():
    agents = np.array([0, 0, 1, 1])
    ways = np.array([2.45, 0.0, 0.0, 0.001])
    seconds = np.ones(4)
    assert judge.median_speeds(agents, ways, seconds, 3).tolist() == [2.45, 0, 0]
    assert judge.check_speeds(np.array([2.45, 0]), judge.HASTE) == 2.45


def test_an_axis_that_is_up_is_found_and_stairs_are_not():
    angle = np.random.default_rng(1).uniform(-np.pi, np.pi, 500)
    places = np.array([np.cumsum(np.cos(angle)), np.zeros(500), np.cumsum(np.sin(angle))])
    assert judge.check_climbs(np.abs(np.cos(angle)), np.sin(angle), places)
    way = np.arange(500)
    for y in (way, np.zeros(500)):  # the second is one agent on a ramp along x
        assert not judge.check_climbs(
            np.ones(500), np.full(500, 0.6), np.array([way, y, 0.6 * way])
        )
    crossing = np.array([way % 10, np.zeros(500), way / 50])  # y is up, and many cross a square
    assert judge.check_climbs(np.ones(500), np.zeros(500), crossing)
    crossing[0, 0] = 1e12  # as far off as a file may have anybody
    assert judge.check_climbs(np.ones(500), np.zeros(500), crossing)


def test_who_floats_and_who_is_sunk_is_found_with_the_height():
    above = np.array([0.01, 1.2, np.nan, -3.0, 1.4, 0, 0, 0])
    floats, sinks = judge.check_ground(above)
    assert (floats.indices.tolist(), floats.height) == ([1, 4], pytest.approx(1.3))
    assert (sinks.indices.tolist(), sinks.height) == ([3], -3.0)
    assert not judge.check_ground(np.array([0.05, 0, np.nan]))
    assert not judge.check_ground(np.full(3, np.nan))


def test_a_pose_that_stands_is_found():
    assert judge.check_poses(np.array([0.03, 3.6])).tolist() == [1]
