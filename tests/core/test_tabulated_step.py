"""Steps within a cell against the plain step, to the bit."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior import step as step_
from crowd_lod_extension.crowd_lod.behavior.plain_step import advance
from crowd_lod_extension.crowd_lod.behavior.step import step
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset, preset_names
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import LabelMap
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.shots import AREA, IDLER, ground, walker
from ..support.steps import odd, same
from ..support.strategies import grounds, seeds, tables

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def small_crowds_step_within_cells(monkeypatch):
    monkeypatch.setattr(step_, "FEW_AGENTS", 0)
    monkeypatch.setattr(step_, "BLOCK", 64)


GROUPS = (walker(), IDLER, walker(stride=0.01))


@settings(max_examples=40)
@given(tables(), grounds, seeds, st.booleans(), st.sampled_from([1 / 24, 0.3, 1e-9, 2.0]))
def test_a_step_is_the_plain_one_to_the_bit(machine, world, seed, strewn, seconds):
    crowd = populate(500, seed, 3, machine, world)
    if machine.edge == "reflect" or strewn:
        crowd = odd(crowd, np.random.default_rng(seed), machine, world)
    for _ in range(6):
        plain, _ = advance(crowd, machine, world, seconds)
        crowd = step(crowd, machine, world, seconds)
        assert same(crowd, plain)


@pytest.mark.parametrize("name", preset_names())
@pytest.mark.parametrize("alike", [False, True])
def test_presets_step_plainly_on_one_label_and_on_many(name, alike):
    machine = load_preset(name)
    labels = np.random.default_rng(1).integers(len(machine.labels), size=(23, 17), dtype=np.uint8)
    labels[:5] = np.flatnonzero(machine.spawn)[0]
    world = LabelMap(labels[:5] if alike else labels, AREA)
    crowd = populate(1000, 1, 3, machine, world)
    for _ in range(3):
        plain, _ = advance(crowd, machine, world, 0.2)
        crowd = step(crowd, machine, world, 0.2)
        assert same(crowd, plain)


def test_most_agents_step_within_cells_and_columns_that_stay_are_shared():
    machine = load_preset("chapter")
    world = ground()
    crowd = populate(1000, 1, 1, machine, world)
    tables = step_.Tables(machine, 1 / 24)
    moved, others = step_.step_within_cells(crowd, machine, world, tables)
    assert len(others) < 50
    assert moved.state is crowd.state and moved.key is crowd.key and moved.wait is crowd.wait
    assert (moved.x != crowd.x).all() and moved.x is not crowd.x
