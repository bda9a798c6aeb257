"""Several crowds of a scene: one plan, overlay and build over all; bad settings are told."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.sources.several import Several
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.scene_frames import frame_at, frame_now


@pytest.fixture
def two(levelled):
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.add_row(kind="crowds")
    more = levelled.crowd_lod.crowds[1]
    more.count = 40
    more.center = (0, 5, 3)
    more.size = (10, 10)
    more.group_names = "child"
    return levelled


def test_agents_of_the_second_crowd_follow_and_show_its_groups(two):
    trajectory = trajectory_of(two)
    assert isinstance(trajectory, Several) and len(trajectory.start) == 340
    names = [group.name for group in trajectory.groups]
    assert {names[group] for group in trajectory.start.group[300:]} == {"child"}
    assert (trajectory.start.z[300:] == 3).all() and trajectory_of(two) is trajectory
    frame = frame_at(two, bpy.context.evaluated_depsgraph_get(), 5)
    assert frame.visible[300:].any() and frame.visible[:300].any()


def test_build_has_both_and_a_hidden_crowd_leaves_it(two):
    bpy.ops.crowd_lod.build()
    frame = frame_now(two, bpy.context.evaluated_depsgraph_get())
    shown = _ids(two)
    assert sorted(shown) == sorted(frame.buckets.order.tolist()) and max(shown) >= 300
    two.crowd_lod.crowds[1].use_crowd = False
    two.frame_set(2)
    assert max(_ids(two)) < 300


def _ids(scene) -> list[int]:
    found = []
    for item in scene.crowd_lod.build.all_objects:
        if item.name.startswith("Crowd LOD") and item.name.endswith("points"):
            found += [each.value for each in item.data.attributes["id"].data]
    return found


def test_removing_the_crowd_gives_the_first_one_back(two):
    alone = Several.__name__
    bpy.ops.crowd_lod.remove_row(kind="crowds")
    trajectory = trajectory_of(two)
    assert type(trajectory).__name__ != alone and len(trajectory.start) == 300


def test_a_group_that_is_not_there_is_named(two):
    two.crowd_lod.crowds[1].group_names = "child, elephant"
    with pytest.raises(CrowdError, match="Crowd 2 names the character group elephant.*adult"):
        trajectory_of(two)


@pytest.mark.once
def test_a_plan_of_the_shot_holds_all_crowds_and_is_told_when_one_changes(two, tmp_path):
    settings = two.crowd_lod
    settings.output_folder = str(tmp_path)
    two.frame_end = 3
    bpy.ops.crowd_lod.plan_shot()
    frame = frame_at(two, bpy.context.evaluated_depsgraph_get(), 2)
    assert frame.planned and len(frame.plan_row) == 340
    settings.crowds[1].seed += 1
    frame = frame_at(two, bpy.context.evaluated_depsgraph_get(), 2)
    assert not frame.planned and "the other crowds" in frame.unplanned
    assert np.isfinite(frame.crowd.x).all()
