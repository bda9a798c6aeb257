"""Steps known ahead against the plain step, to the bit."""

import dataclasses
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior import lookahead
from crowd_lod_extension.crowd_lod.behavior import step as step_
from crowd_lod_extension.crowd_lod.behavior.lookahead import look_ahead, plan_turns, step_ahead
from crowd_lod_extension.crowd_lod.behavior.plain_step import advance
from crowd_lod_extension.crowd_lod.behavior.step import PAUSE, Steps
from crowd_lod_extension.crowd_lod.behavior.tabulated_step import Tables
from crowd_lod_extension.crowd_lod.crowd.leave_outs import ALL
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset, preset_names
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import LabelMap
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.shots import AREA, ground, shot, walking
from ..support.steps import odd, same
from ..support.strategies import grounds, seeds, tables

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def every_crowd_looks_ahead(monkeypatch):
    monkeypatch.setattr(step_, "FEW_AGENTS", 0)
    monkeypatch.setattr(lookahead, "MANY", 1.0)


def check(crowd, machine, world, seconds, steps):
    """The steps of `crowd` are plain ones, to the bit; return the part that was known ahead."""
    whole = Tables(machine, seconds)
    part = Tables(machine, 0.37 * seconds)

    def plain(crowd, seconds):
        return advance(crowd, machine, world, seconds)[0]

    plain_whole = partial(plain, seconds=seconds)
    plain_part = partial(plain, seconds=part.seconds)
    known = 0.0
    ahead = look_ahead(crowd, machine, world, whole)
    for _ in range(steps):
        if not ahead.turns:
            ahead = plan_turns(crowd, ahead, machine, world, whole, plain_whole)
        known += (1 - len(ahead.turns[0].agents) / len(crowd)) / steps
        between, nothing = step_ahead(crowd, ahead, part, plain_part)
        assert same(between, plain_part(crowd)) and nothing is None
        expected = plain_whole(crowd)
        crowd, ahead = step_ahead(crowd, ahead, whole, plain_whole)
        assert same(crowd, expected)
    return known


@settings(max_examples=24)
@given(
    tables(),
    grounds,
    seeds,
    st.sampled_from([None, 0, 1]),
    st.booleans(),
    st.sampled_from([1 / 24, 0.3, 1e-9, 2.0]),
    st.sampled_from([0, 0.5, 1]),
)
def test_steps_are_plain_ones_to_the_bit(machine, world, seed, axis, strewn, seconds, few):
    if axis is not None:  # along one side of the cells
        machine = replace(machine, velocity=machine.velocity * np.eye(2)[axis])
    crowd = populate(400, seed, 3, machine, world)
    if machine.edge == "reflect" or strewn:
        crowd = odd(crowd, np.random.default_rng(seed), machine, world)
        crowd.x[10:20] = -0.0
        crowd.y[20:30] = -0.0
        crowd.x[30] = np.nextafter(AREA.x_max, 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lookahead, "BLOCK", 64)
        patch.setattr(lookahead, "FEW", few)
        patch.setattr(lookahead, "CHEAP", 0)
        check(crowd, machine, world, seconds, 12)


@pytest.mark.parametrize("name", preset_names())
def test_presets_know_most_steps_of_long_shots(name):
    machine = load_preset(name)
    random = np.random.default_rng(1)
    labels = np.kron(
        random.integers(len(machine.labels), size=(3, 4)), np.ones((4, 4), int)
    ).astype(np.uint8)
    labels[:, :4] = np.flatnonzero(machine.spawn)[0]
    crowd = populate(500, 1, 3, machine, LabelMap(labels, AREA))
    assert check(crowd, machine, LabelMap(labels, AREA), 1 / 24, 100) > 0.8


@pytest.mark.parametrize("axis, cells", [(0, 0.4), (0, 1.2), (1, 0.9), (1, 2.6)])
def test_through_cells_of_one_label_goes_on_who_skips_none(axis, cells):
    world = LabelMap(np.repeat(ground([(3, 20)], (7, 40)).labels, 9, axis=0), AREA)
    machine = walking()
    way = np.eye(2)[axis]
    machine = replace(
        machine, velocity=np.sign(machine.velocity[..., :1]) * way * world.cell[axis] * cells * 24
    )
    known = check(populate(300, 1, 3, machine, world), machine, world, 1 / 24, 30)
    assert (
        known > 0.5 if cells < 1 else known < 0.5 if cells < 2 else known == 0
    )  # steps of 1.2 cells may lead into the next


@pytest.mark.parametrize("turn, cells", [(1, 0.1), (2, 0.1), (2, 0.9), (3, 0.03), (6, 0.03)])
def test_aslant_among_cells_of_one_label(turn, cells):
    """In sixteenths of a turn; some start on corners and borders, from where both are crossed at
    once.
    """
    world = LabelMap(np.kron(ground([(2, 4)]).labels, np.ones((6, 6), int)).astype(np.uint8), AREA)
    machine = walking()
    way = np.array([np.cos(turn * np.pi / 8), np.sin(turn * np.pi / 8)])
    velocity = (
        np.sign(machine.velocity[..., :1]) * way / np.abs(way).max() * world.cell * cells * 24
    )
    machine = replace(machine, velocity=velocity)
    crowd = populate(300, turn, 3, machine, world)
    for place, low, size in (
        (crowd.x, AREA.x_min, world.cell[0]),
        (crowd.y, AREA.y_min, world.cell[1]),
    ):
        place[:100] = low + np.round((place[:100] - low) / size * 4) / 4 * size
    known = check(crowd, machine, world, 1 / 24, 60)
    assert known > 0.8 or cells > 0.5


def test_far_from_the_origin_and_at_nan_nothing_is_known_that_does_not_hold():
    area = dataclasses.replace(AREA, x_min=1e7 - 40, x_max=1e7 + 40)
    machine = walking()
    world = LabelMap(ground([(3, 4)]).labels, area)
    assert check(populate(500, 1, 3, machine, world), machine, world, 1e-6, 40) > 0.5
    crowd = populate(50, 1, 3, machine, world)
    crowd.x[:10] = np.nan
    crowd.y[5:20] = np.inf
    tables = Tables(machine, 1 / 24)
    assert not look_ahead(crowd, machine, world, tables).steps[:20].any()


@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect", "stop"])
@pytest.mark.parametrize("few", [0.0, 1.0])
def test_a_trajectory_is_the_same_whichever_frames_were_asked_for(edge, few, monkeypatch):
    monkeypatch.setattr(lookahead, "FEW", few)
    monkeypatch.setattr(lookahead, "CHEAP", 0)
    trajectory = shot(walking(edge), ground([(3, slice(None))]), count=300)
    times = *range(1, 40), 12.5, 13, 14, 3.25, 70, 70.5, 69.75, 71, 30, 31, 32.5
    for time in times:
        assert same(trajectory.at(time), trajectory.full.at(time))


def test_a_crowd_that_is_timed_walks_the_same_way():
    trajectory = shot(walking(), ground([(3, slice(None))]), count=300)
    timed = trajectory.leaving(ALL, 9)
    assert all(same(timed.at(time), trajectory.at(time)) for time in (9, 10, 11))


@pytest.mark.parametrize("row, known", [(1 / 24, True), (None, False)])
def test_steps_in_a_row_are_known_ahead_and_those_that_stand_alone_are_not(row, known):
    machine = walking()
    world = ground([(3, slice(None))])
    steps = Steps(machine, world, row)
    steps.after(populate(300, 1, 3, machine, world), 1 / 24)
    assert steps.looks_ahead == known


def test_one_door_gives_plain_steps_whatever_it_is_asked_for():
    """Steps in a row, shorter ones between, others from other crowds, and back."""
    machine = walking("wrap")
    world = ground([(3, slice(None))])
    steps = Steps(machine, world, 1 / 24)
    first = populate(300, 1, 3, machine, world)
    crowd = first
    for number in range(40):
        for seconds in (1 / 24, 0.01, 1 / 24):
            moved = steps.after(crowd, seconds)
            assert same(moved, advance(crowd, machine, world, seconds)[0])
        if number % 8 == 5:
            assert same(steps.after(first, 1 / 24), advance(first, machine, world, 1 / 24)[0])
        crowd = replace(moved, phase_class=moved.phase_class.copy())
    assert steps.looks_ahead


def test_who_looked_in_vain_looks_again_after_a_pause(monkeypatch):
    monkeypatch.setattr(lookahead, "MANY", 0.2)
    world = ground()
    machine = walking()
    speeds = np.reshape((200.0, 1.0), (2, 1, 1))  # of who walks on, and of who walks back
    machine = replace(machine, velocity=machine.velocity * speeds)
    steps = Steps(machine, world, 1 / 24)
    fast = populate(300, 1, 3, machine, world)
    slow = replace(fast, state=np.ones_like(fast.state))
    slow, _ = advance(slow, machine, world, 1 / 24)  # they have turned
    assert steps.after(fast, 1 / 24) and not steps.looks_ahead
    for _ in range(PAUSE):
        assert steps.after(slow, 1 / 24) and not steps.looks_ahead
    assert steps.after(slow, 1 / 24) and steps.looks_ahead


@pytest.mark.parametrize("shape", [(7, 9), (1, 64), (5, 1), (3, 600)])
def test_runs_are_those_of_a_walk_from_cell_to_cell(shape):
    labels = (np.random.default_rng(1).random(shape) < 0.1).astype(np.uint8)
    runs = LabelMap(labels, AREA).runs.reshape(2, 2, *shape)
    for axis, (down, right) in enumerate([(0, 1), (1, 0)]):
        for sign in (0, 1):
            for row, column in np.ndindex(shape):
                count = 0
                r = row
                c = column
                while True:
                    r = r + down * (2 * sign - 1)
                    c = c + right * (2 * sign - 1)
                    if (
                        not (0 <= r < shape[0] and 0 <= c < shape[1])
                        or labels[r, c] != labels[row, column]
                    ):
                        break
                    count += 1
                assert runs[axis, sign, row, column] == min(count, 255)
