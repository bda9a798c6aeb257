"""Timers end after their seconds, and chances follow their weights, however long a step is."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.step import step
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import walker
from ..support.machines import machine_of, random_world, same
from ..support.shots import every_step


def test_timers_and_chances_do_not_depend_on_the_length_of_the_step():
    """Here no label changes the state, so stepping is exact: any step gives the same events at the
    same times.
    """
    machine = machine_of(
        {
            "go": {
                "start": 1,
                "after": [0.3, 2],
                "then": {"back": 2, "rest": 1},
                "on": {"*": {"move": [1, 0.2]}},
            },
            "back": {
                "after": 0.7,
                "then": {"go": 1, "rest": 3, "back": 1},
                "on": {"*": {"move": [-1, 0.4]}},
            },
            "rest": {"after": [0.1, 0.2], "then": "go", "on": {"*": {}}},
        },
        "wrap",
    )
    world = random_world(np.random.default_rng(0), 2)
    start = populate(500, 9, 1, machine, world)
    coarse = fine = start
    for _ in range(5):
        coarse = step(coarse, machine, world, 2.0)
    for _ in range(240):
        fine = step(fine, machine, world, 1 / 24)
    assert (
        (coarse.state == fine.state).all()
        and (coarse.key == fine.key).all()
        and (start.key != fine.key).all()
    )
    np.testing.assert_allclose(coarse.wait, fine.wait, atol=1e-4)
    np.testing.assert_allclose(coarse.x, fine.x, atol=1e-3)


def test_timers_end_after_their_seconds():
    machine = machine_of(
        {"a": {"start": 1, "after": [2, 4], "then": "b", "on": {"*": {}}}, "b": {"on": {"*": {}}}}
    )
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1, 1))
    crowd = populate(20_000, 0, 1, machine, world)
    left = []
    for _ in range(50):
        crowd = step(crowd, machine, world, 0.1)
        left.append((crowd.state == 0).mean())
    assert left[18] == 1 and left[41] == 0
    expected = np.interp(0.1 * np.arange(1, 51), [2, 4], [1, 0])
    np.testing.assert_allclose(left, expected, atol=5 * np.sqrt(0.25 / 20_000) + 1e-3)


@pytest.mark.once
@pytest.mark.parametrize("after, fps", [(3600, 0.7), (1000.1, 3)])
def test_a_long_timer_ends_on_time(after, fps):
    """Who goes when the timer ends is as far as the time since then: to a microsecond, by whatever
    steps.
    """
    machine = machine_of(
        {
            "a": {"start": 1, "after": after, "then": "b", "on": {"*": {}}},
            "b": {"on": {"*": {"move": [1, 0]}}},
        }
    )
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1000, 1))
    shot = Walk(populate(2, 0, 1, machine, world), machine, world, (walker(),), 1 / fps, 0)
    frames = int((after + 2) * fps)
    np.testing.assert_allclose(shot.at(frames).x - shot.start.x, frames / fps - after, atol=1e-6)
    np.testing.assert_allclose(shot.at(int((after - 0.5) * fps)).x, shot.start.x, atol=0)


@pytest.mark.once
def test_a_timer_of_ten_million_seconds_runs_at_sixty_frames_a_second():
    after = 1e7
    machine = machine_of(
        {"a": {"start": 1, "after": after, "then": "a", "on": {"*": {"move": [1, 0]}}}}, "wrap"
    )
    world = LabelMap(np.zeros((4, 4), np.uint8), Area(0, 0, 40, 40))
    crowd = populate(20, 0, 1, machine, world)
    shot = Walk(crowd, machine, world, (walker(),), 1 / 60, 0)
    for crowd in (shot.at(3600), every_step(shot).at(3600)):
        np.testing.assert_allclose(crowd.wait, after - 60, atol=1e-5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("after", [1e39, 1e300, 1.7e308, [1, 1.7e308]])
def test_a_timer_that_nobody_lives_to_see_runs_without_a_warning(after):
    machine = machine_of(
        {"a": {"start": 1, "after": after, "then": "a", "on": {"*": {"move": [0.1, 0]}}}}
    )
    world = LabelMap(np.zeros((4, 4), np.uint8), Area(0, 0, 40, 40))
    crowd = populate(5000, 0, 1, machine, world)
    assert np.isfinite(crowd.wait).all()
    shot = Walk(crowd, machine, world, (walker(),), 1e-3, 0)
    assert (
        same(shot.at(40), every_step(shot).at(40))
        and (shot.at(40).state == 0).all()
        and np.isfinite(shot.at(40).wait).all()
    )


def test_chances_follow_their_weights_and_fall_once_a_label():
    """The label is four cells wide and takes 80 steps to cross: still one draw."""
    turn = {"next": {"left": 3, "right": 1, "on": 4}, "move": [1, 0]}
    states = {"on": {"start": 1, "on": {"ground": {"move": [1, 0]}, "wall": turn}}}
    states |= {name: {"on": {"*": {"move": [1, 0]}}} for name in ("left", "right")}
    machine = machine_of(states)
    world = LabelMap(np.array([[0, 1, 1, 1, 1, 0, 0]], np.uint8), Area(0, 0, 7, 1))
    crowd = populate(20_000, 5, 1, machine, LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1, 1)))
    for _ in range(120):
        crowd = step(crowd, machine, world, 0.05)
    share = np.bincount(crowd.state, minlength=3) / 20_000
    np.testing.assert_allclose(share, [4 / 8, 3 / 8, 1 / 8], atol=5 * np.sqrt(0.25 / 20_000))


def test_a_label_is_drawn_for_anew_each_time_it_is_entered():
    """Round a ring with one crossing, where one in two turns off: after three rounds one in eight
    still walks.
    """
    states = {
        "on": {
            "start": 1,
            "on": {"*": {"move": [1, 0]}, "wall": {"move": [1, 0], "next": {"on": 1, "off": 1}}},
        },
        "off": {"on": {"*": {"move": [1, 0]}}},
    }
    machine = machine_of(states, "wrap")
    world = LabelMap(np.array([[0, 0, 0, 1]], np.uint8), Area(0, 0, 4, 1))
    crowd = populate(20_000, 2, 1, machine, LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 3, 1)))
    for _ in range(48):
        crowd = step(crowd, machine, world, 0.25)
    assert (crowd.state == 0).mean() == pytest.approx(1 / 8, abs=5 * np.sqrt(0.25 / 20_000))


def test_what_follows_a_timer_does_not_hang_on_what_the_label_drew():
    states = {
        "on": {
            "start": 1, "after": 1, "then": {"left": 1, "right": 1},
            "on": {"ground": {"next": {"on": 1, "off": 1}}, "wall": {}},
        },
        **{name: {"on": {"*": {}}} for name in ("off", "left", "right")},
    }  # fmt: skip
    machine = machine_of(states)
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1, 1))
    crowd = populate(20_000, 2, 1, machine, world)
    for _ in range(3):
        crowd = step(crowd, machine, world, 0.75)
    share = np.bincount(crowd.state, minlength=4) / 20_000
    np.testing.assert_allclose(share, [0, 1 / 2, 1 / 4, 1 / 4], atol=5 * np.sqrt(0.25 / 20_000))
