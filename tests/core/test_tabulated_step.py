"""Steps within a cell against the long way, to the bit."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior import step as step_
from crowd_lod_extension.crowd_lod.behavior import tabulated_step
from crowd_lod_extension.crowd_lod.behavior.step import advance, step
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.crowd.agents import populate
from crowd_lod_extension.crowd_lod.crowd.maps import LabelMap
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset, preset_names
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.shots import AREA, IDLER, ground, walker
from ..support.steps import odd, same
from ..support.strategies import grounds, seeds, tables

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def small_crowds_go_the_short_way(monkeypatch):
    monkeypatch.setattr(step_, "FEW_AGENTS", 0)
    monkeypatch.setattr(tabulated_step, "BLOCK", 64)


GROUPS = (walker(), IDLER, walker(stride=0.01))


@settings(max_examples=40)
@given(tables(), grounds, seeds, st.booleans(), st.sampled_from([1 / 24, 0.3, 1e-9, 2.0]))
def test_a_step_is_the_long_way_to_the_bit(machine, world, seed, strewn, seconds):
    crowd = populate(500, seed, 3, machine, world)
    if machine.edge == "reflect" or strewn:
        crowd = odd(crowd, np.random.default_rng(seed), machine, world)
    for _ in range(6):
        short, (long, _) = (
            step(crowd, machine, world, seconds),
            advance(crowd, machine, world, seconds),
        )
        assert same(short, long)
        crowd = short


@pytest.mark.parametrize("name", preset_names())
def test_presets_and_what_is_left_out(name):
    machine, random = load_preset(name), np.random.default_rng(1)
    labels = random.integers(len(machine.labels), size=(23, 17), dtype=np.uint8)
    for world in (LabelMap(labels, AREA), LabelMap(labels[:1, :1], AREA)):
        crowd = populate(3000, 1, 3, machine, world) if machine.spawn[labels[0, 0]] else None
        for _ in range(3 if crowd else 0):
            leave = leave_outs.needless(crowd, machine, world, 3, False)
            assert (leave_outs.ONE_LABEL in leave) == (world.labels.size == 1)
            short, (long, _) = (
                step(crowd, machine, world, 0.2, leave),
                advance(crowd, machine, world, 0.2),
            )
            assert same(short, long)
            crowd = short


def test_most_agents_go_the_short_way_and_columns_that_stay_are_shared():
    machine, world = load_preset("chapter"), ground()
    crowd = populate(1000, 1, 1, machine, world)
    moved, rest = tabulated_step.within(
        crowd, machine, world, tabulated_step.Tables(machine, 1 / 24), leave_outs.NOTHING
    )
    assert len(rest) < 50
    assert moved.state is crowd.state and moved.key is crowd.key and moved.wait is crowd.wait
    assert (moved.x != crowd.x).all() and moved.x is not crowd.x
