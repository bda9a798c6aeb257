"""How fast an action walks: by its feet or its root motion, and told where feet would slide."""

import bpy
import mathutils
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.blender.named_actions import performance_of
from crowd_lod_extension.operators.scene.characters.character_notes import notes_on_actions
from crowd_lod_extension.operators.scene.scene_crowd import characters_of

from ..support.messages import sentences
from ..support.rigs import itself
from .test_actions import going, group_of, name_actions, waiting  # noqa: F401


def test_a_stride_is_measured_by_the_feet_and_an_idle_plays_by_time(waiting):  # noqa: F811
    group = group_of(waiting, walk=going("walk"), wait=going("idle", 0))
    walk = group.action("walk")
    idle = group.action("idle")
    solved = waiting.crowd_lod.characters.children["adult"][
        "stride"
    ]  # by which the feet of the walk were placed
    assert walk.stride == pytest.approx(solved, rel=2e-3) and walk.period == pytest.approx(26 / 24)
    assert idle.stride == 0 and idle.period == pytest.approx(104 / 24)
    assert bpy.data.objects["adult rig"].animation_data.action.name == "walk adult"


def traveling(scene, way=1.3541666):
    """An action "stroll adult": the walk, moved forward by its stride in a cycle."""
    action = bpy.data.actions["walk adult"].copy()
    action.name = "stroll adult"
    rig = bpy.data.objects["adult rig"]
    before = rig.animation_data.action
    rig.animation_data.action = action
    bone = rig.data.bones["hips"].matrix_local.to_3x3()
    for index in range(3):
        curve = action.fcurve_ensure_for_datablock(rig, 'pose.bones["hips"].location', index=index)
        for key in curve.keyframe_points:
            key.co.y += (bone.transposed() @ mathutils.Vector((way * (key.co.x - 1) / 26, 0, 0)))[
                index
            ]
        curve.update()
    rig.animation_data.action = before
    return action


def test_root_motion_is_taken_out_and_is_the_stride(waiting):  # noqa: F811
    traveling(waiting)
    waiting.crowd_lod.characters.children.unlink(waiting.crowd_lod.characters.children["child"])
    group = group_of(waiting, go=going("stroll"))
    assert group.action("stroll").stride == pytest.approx(1.3541666, rel=1e-4)
    told = sentences(notes_on_actions(waiting, [group]))
    assert (
        len(told) == 1
        and "stroll adult moves adult by 1.35 m in a cycle: that is taken out" in told[0]
    )
    (_, objects, _) = characters_of(waiting)[0]
    actions = len(bpy.data.actions)
    stage = bpy.data.scenes.new("stage")
    for item in (*objects, objects[0].parent):
        stage.collection.objects.link(item)
    act = performance_of("adult", objects, ["stroll"]).only("stroll")
    for frame in (1, 9.5, 27):
        act.go_to(stage, frame)
        depsgraph = stage.view_layers[0].depsgraph
        mine = mesh_data.world_points(objects[0].evaluated_get(depsgraph))
        act.rest()
        assert (
            np.abs(
                mine - itself(waiting, 0, (frame - 1) / 26, bpy.data.actions["walk adult"])
            ).max()
            < 1e-5
        )
    assert (
        len(bpy.data.actions) == actions
        and bpy.data.objects["adult rig"].animation_data.action.name == "walk adult"
    )


def test_feet_that_slide_are_told_with_the_stride_or_the_speed_that_fits(waiting):  # noqa: F811
    bpy.data.actions["walk adult"]["stride"] = 1.5
    (told,) = sentences(notes_on_actions(waiting, [group_of(waiting, walk=going("walk"))]))
    assert "slide by 0.147 m in a cycle of walk adult: set its property stride to 1.35 m." in told
    (told,) = sentences(notes_on_actions(waiting, [group_of(waiting, wait=going("idle", 0.5))]))
    assert "feet of adult slide by 2.17 m in a cycle of idle adult: give the state" in told
    assert told.endswith("the speed 0 m/s.")
    del bpy.data.actions["walk adult"]["stride"]
    assert not list(
        notes_on_actions(waiting, [group_of(waiting, walk=going("walk"), wait=going("idle", 0))])
    )
