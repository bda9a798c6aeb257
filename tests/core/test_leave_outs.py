import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import Bias
from crowd_lod_extension.crowd_lod.world.maps import LabelMap
from hypothesis import given, settings

from ..support.cameras import straight
from ..support.crowds import walker
from ..support.shots import (
    AREA,
    IDLER,
    POLICY,
    every_step,
    full_plan,
    known,
    machine,
    shot,
    walking,
)
from ..support.strategies import shots

pytestmark = pytest.mark.once


def left(trajectory, camera, policy=POLICY, time=9, *more):
    """What the plan left out, after it was compared with the full one."""
    short = plan(trajectory, camera, policy, time, *more)
    full = full_plan(every_step(trajectory), camera, policy, time, *more)
    assert full.left_out == ()
    assert known(short) == known(full)
    return set(short.left_out)


@pytest.mark.once
def test_any_shot_is_the_full_pipelines_to_the_bit():
    found = set()

    @settings(max_examples=60)
    @given(shots((walker(), IDLER, walker(stride=0.7)), [120]))
    def the_same(shot):
        trajectory, camera, policy, shutter, bias = shot
        for time in (1, 9, 9, 5.25):
            found.update(left(trajectory, camera, policy, time, shutter, bias))

    the_same()
    assert found >= {leave_outs.STATIC, leave_outs.STILL}  # of blocks see test_blocks


def test_behavior_is_left_out_where_nobody_ever_walks():
    camera = straight(offset=(0, 30, 0))
    assert leave_outs.STILL in left(shot(), camera)
    assert leave_outs.STILL not in left(shot(walking()), camera)
    # a state that agents come to by their timer alone walks
    sits = {"color": "#ff0000", "start": 1, "after": [0.1, 0.1], "then": "goes", "on": {"*": {}}}
    timed = machine(
        {
            "sits": sits,
            "goes": {"color": "#00ff00", "on": {"*": {"move": [1, 0]}, "wall": {"next": "sits"}}},
        }
    )
    assert not shot(timed).still


def test_a_crowd_that_stands_plays_its_actions_and_is_planned_once():
    trajectory = shot(groups=(IDLER, walker()))
    camera = straight(offset=(0, 30, 0))
    first = plan(trajectory, camera, POLICY, 9)
    assert leave_outs.STATIC not in first.left_out and leave_outs.STILL in first.left_out
    for time in (10, 40, 3, 7.25):
        assert leave_outs.STATIC in left(trajectory, straight(offset=(0, 30, 0)), POLICY, time)
    everyone = slice(None)
    assert (
        plan(trajectory, camera, POLICY, 12).phase_of(everyone) != first.phase_of(everyone)
    ).any()
    changes = [
        (replace(camera, far=99.0), POLICY),
        (replace(camera, origin=np.array([0, np.nextafter(30, 31), 0])), POLICY),
        ((camera, camera), POLICY),
        (camera, replace(POLICY, margin=0.5)),
        (camera, POLICY, Bias(np.full((2, 2), 0.25), AREA)),
        (camera, POLICY, Bias(np.array([[0.0, 1.0]]), AREA)),
        (camera, POLICY, Bias(np.array([[0.0], [1.0]]), AREA)),
        (camera, POLICY, None),
    ]
    for view, policy, *bias in changes:
        assert leave_outs.STATIC not in left(trajectory, view, policy, 12, (), *bias)
        assert leave_outs.STATIC in left(trajectory, view, policy, 12, (), *bias)
    open_ = [(11.5, (camera,)), (12.5, (straight(offset=(1, 30, 0)),))]
    assert leave_outs.STATIC not in left(trajectory, camera, POLICY, 12, open_)
    assert leave_outs.STATIC in left(trajectory, camera, POLICY, 12, open_)
    assert leave_outs.STATIC not in left(
        trajectory, camera, POLICY, 12, [*open_[:1], (12.5, (straight(offset=(2, 30, 0)),))]
    )


def test_an_audience_that_cheers_is_planned_once():
    trajectory = shot(load_preset("audience"), count=3000, seated=True)
    camera = straight(offset=(0, 30, 0))
    states = trajectory.at(9).state
    assert leave_outs.STATIC not in left(trajectory, camera)
    for time in (100, 60.25):
        assert left(trajectory, camera, POLICY, time) & {leave_outs.STATIC, leave_outs.STILL} == {
            leave_outs.STATIC
        }
        assert (trajectory.at(time).state != states).any()
    assert leave_outs.STATIC not in left(trajectory, straight(offset=(1, 30, 0)))


def test_what_is_kept_of_a_crowd_ends_with_it():
    for table in (None, walking()):  # of one that stands, the last plan is kept, too
        trajectory = shot(table)
        frames = [plan(trajectory, straight(), POLICY, 5) for _ in range(2)]
        assert (leave_outs.STATIC in frames[1].left_out) == (table is None) and frames[
            1
        ].trajectory is trajectory
        end = weakref.ref(trajectory)
        del trajectory, frames
        gc.collect()
        assert end() is None


def test_agents_off_the_map_are_taken_onto_it_before_they_stand():
    trajectory = shot()
    x = trajectory.start.x.copy()
    x[:3] = -70, 90, -0.0
    aside = replace(trajectory, start=replace(trajectory.start, x=x))
    for time in (1, 1.5, 2, 5):
        assert leave_outs.STILL in left(aside, straight(offset=(0, 30, 0)), POLICY, time)


def test_presets_lean_and_full():
    for name in ("audience", "chapter", "plaza", "concourse", "evacuation", "market"):
        table = load_preset(name)
        random = np.random.default_rng(2)
        world = LabelMap(random.integers(len(table.labels), size=(11, 13), dtype=np.uint8), AREA)
        trajectory = shot(table, world, (Group("g", 1.0, 1.1, 0.0, 1.3),), 300)
        left(trajectory, straight(offset=(0, 30, 0)), POLICY, 30.5)
