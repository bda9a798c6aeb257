"""Whether a character walks by the way that its action travels."""

import pytest
from crowd_lod_extension.crowd_lod.crowd.strides import Cycle, Plays, how_it_plays

WALKERS = (0.0, 1.25)


def plays(way, period=1.0, given=0.0, feet=0.0, size=2.0, speeds=WALKERS):
    return how_it_plays(given, Cycle(period, way, feet, size), (0, -1), speeds)


@pytest.mark.parametrize(
    "way, period, found",
    [
        ((0, -1.3), 1.0, Plays.WAY),
        ((0, -12.0), 10.0, Plays.WAY),  # a take of many steps
        ((0, -0.5), 1.0, Plays.WAY),  # who strolls
        ((0, -3.6), 1.0, Plays.WAY),  # who runs
        ((0.5, -1.0), 1.0, Plays.WAY),  # nearly ahead
        ((0, -0.02), 1.0, Plays.OFF_SPEED),
        ((0, -0.2), 1.0, Plays.OFF_SPEED),
        ((0, -0.3), 10.0, Plays.OFF_SPEED),
        ((0, -2.0), 0.3, Plays.OFF_SPEED),  # a leap
        ((0, 1.3), 1.0, Plays.ASIDE),
        ((1.3, 0), 1.0, Plays.ASIDE),
        ((0, 0), 1.0, Plays.IN_PLACE),
    ],
)
def test_a_way_is_a_stride_at_about_the_speed_of_agents_and_ahead(way, period, found):
    assert plays(way, period) is found


@pytest.mark.parametrize("size, speed", [(0.1, 0.06), (1.3, 0.8), (2.8, 1.6), (340, 220)])
def test_speeds_are_of_the_characters_size(size, speed):
    """A toy, a child, a horse, and a person who was imported a hundred times as large."""
    assert plays((0, -speed), size=size) is Plays.WAY
    assert plays((0, -speed / 6), size=size) is Plays.OFF_SPEED


def test_any_of_the_speeds_counts_and_who_stands_plays_by_time():
    assert plays((0, -4.0), speeds=(1.0, 4.0)) is Plays.WAY
    assert plays((0, -1.3), speeds=(0.0,)) is Plays.NOBODY_WALKS
    assert plays((0, -1.3), speeds=()) is Plays.NOBODY_WALKS
    assert plays((0, 0), speeds=()) is Plays.IN_PLACE


def test_what_the_user_gives_is_the_stride():
    assert plays((0, -0.02), given=0.02) is Plays.GIVEN


def test_feet_that_walk_are_a_stride_and_feet_that_drift_are_none():
    assert plays((0, 0), feet=1.3) is Plays.FEET
    assert plays((0, -0.05), feet=1.3) is Plays.FEET  # it walks in its place, and drifts
    assert plays((0, -0.05), feet=0.05) is Plays.OFF_SPEED
    assert plays((0, 0), feet=0.05) is Plays.IN_PLACE
    assert plays((0, 0), feet=1.3, speeds=(0.3,)) is Plays.FEET  # who walks slowly
    assert plays((0, 0), feet=1.3, speeds=(0.0,)) is Plays.IN_PLACE
