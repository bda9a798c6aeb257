"""The plaza's state machine on the plaza's plan: a complete table, and a crowd that stays out of
its walls.
"""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.step import step
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.sample_scenes import NAMES, make, plaza_map

WALK = Group("walker", center=0.9, radius=1.0, stride=1.35, period=1.0)


@pytest.fixture(scope="module")
def machine():
    return load_preset("plaza")


@pytest.fixture(scope="module")
def world(machine):
    return plaza_map.plan(machine)


def test_all_walk_at_the_pace_of_their_walk_cycle(machine):
    pace = np.hypot(*np.moveaxis(machine.velocity, 2, 0))
    lingering = np.array(machine.labels) == "waiting area"
    np.testing.assert_allclose(pace[:, ~lingering], 1.25, rtol=1e-12)
    np.testing.assert_allclose(pace[:, lingering], 0.5, rtol=1e-12)


def test_a_turn_label_turns_by_a_sixteenth_until_it_is_followed(machine):
    count = len(machine.states)
    for eighth, turn in enumerate(plaza_map.TURNS):
        label = machine.labels.index(f"turn {turn}")
        for state in range(count):
            after = int(machine.next_state[state, label])
            away = min((state - 2 * eighth) % count, (2 * eighth - state) % count)
            left = min((after - 2 * eighth) % count, (2 * eighth - after) % count)
            assert left == max(0, away - 1)
            assert min((after - state) % count, (state - after) % count) <= 1
            # the heading that the walker takes is the new state's own
            np.testing.assert_allclose(
                machine.velocity[state, label], machine.velocity[after, 0], atol=1e-12
            )


def test_a_wall_sends_back_the_way_one_came(machine):
    for label in ("wall", "water"):
        column = machine.labels.index(label)
        back = machine.velocity[:, column]
        np.testing.assert_allclose(back, -machine.velocity[:, 0], atol=1e-12)
        np.testing.assert_allclose(
            back, machine.velocity[machine.next_state[:, column], 0], atol=1e-12
        )


def test_beside_an_obstacle_the_plan_says_the_way_out(machine, world):
    """Following a turn label from any cell leaves the turn labels within 2 m, through no wall."""
    blocked = np.isin(world.labels, [machine.labels.index("wall"), machine.labels.index("water")])
    first = machine.labels.index("turn east")
    row, column = np.nonzero(world.labels >= first)
    for _ in range(8):
        inside = world.labels[row, column] >= first
        angle = (world.labels[row, column].astype(int) - first) * np.pi / 4
        row = row + np.where(inside, np.rint(np.sin(angle)), 0).astype(int)
        column = column + np.where(inside, np.rint(np.cos(angle)), 0).astype(int)
        assert min(row.min(), column.min()) >= 0 and max(row.max(), column.max()) < len(
            world.labels
        )
        assert not blocked[row, column].any()
    assert (world.labels[row, column] < first).all()


@pytest.mark.once
@pytest.mark.parametrize("frames_per_second", [24, 60])
def test_the_crowd_walks_on_and_stays_out_of_the_walls(machine, world, frames_per_second):
    crowd = populate(3000, 3, 1, machine, world)
    solid = [machine.labels.index("wall"), machine.labels.index("water")]
    first = machine.labels.index("turn east")
    turning = longest = np.zeros(len(crowd), int)
    for _ in range(500):
        crowd = step(crowd, machine, world, 1 / frames_per_second)
        label = world.at(crowd.x, crowd.y)
        assert not np.isin(label, solid).any()
        turning = np.where(label >= first, turning + 1, 0)
        longest = np.maximum(longest, turning)
    half = plaza_map.SIZE / 2
    assert max(abs(crowd.x).max(), abs(crowd.y).max()) < half - 0.25  # nobody leans on the border
    assert longest.max() < 1.5 * 24  # nobody is caught beside a wall
    assert (
        np.bincount(crowd.state, minlength=16).min() > 3000 / 16 / 2
    )  # all headings are still there
    quadrants, _, _ = np.histogram2d(crowd.x, crowd.y, bins=2, range=[[-half, half]] * 2)
    assert quadrants.min() > 3000 / 4 * 0.75


def test_an_unknown_scene_is_refused_by_name():
    with pytest.raises(CrowdError, match=f"'piazza'.*{NAMES[0]}, {NAMES[1]}"):
        make("piazza", None)
