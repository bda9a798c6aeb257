"""A bake's rigs keep the keys that its frames need."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.build.baked_actions import trim_actions
from crowd_lod_extension.operators.build.phase_characters import make_characters
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd


@pytest.fixture
def rigs(levelled):
    """Some rigs of the small crowd, linked, so that Blender poses them."""
    found = finished(make_characters(read_crowd(levelled))).rigs[::7]
    for rig in found:
        levelled.collection.objects.link(rig)
    assert found
    return found


def poses(scene, rigs, times):
    """The matrices of all bones (times, bones, 4, 4)."""
    rows = []
    for time in times:
        scene.frame_set(int(np.floor(time)), subframe=time % 1)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        posed = [rig.evaluated_get(depsgraph).pose.bones for rig in rigs]
        rows.append([np.array(bone.matrix) for bones in posed for bone in bones])
    return np.array(rows)


def key_count(rigs):
    """The keys of all actions of the rigs."""
    actions = {rig.animation_data.nla_tracks[0].strips[0].action for rig in rigs}
    curves = [
        curve
        for action in actions
        for layer in action.layers
        for strip in layer.strips
        for bag in strip.channelbags
        for curve in bag.fcurves
    ]
    return sum(len(curve.keyframe_points) for curve in curves)


@pytest.mark.parametrize("frames", [(5,), (1, 2, 3, 30), (-7, 4000)])
def test_rigs_move_as_before_about_the_frames_of_a_bake(levelled, rigs, frames):
    times = [frame + part for frame in frames for part in (-1, 0.3, 1)]
    before = poses(levelled, rigs, times)
    finished(trim_actions(rigs, frames))
    assert np.abs(poses(levelled, rigs, times) - before).max() < 1e-4


def test_few_frames_need_few_keys(rigs):
    whole = key_count(rigs)
    moving = [rig for rig in rigs if len(times_of(rig)) > 1]
    finished(trim_actions(moving[:1], [5.0]))
    assert key_count(moving[:1]) < whole / 2


def times_of(rig):
    return rig.animation_data.nla_tracks[0].strips[0].fcurves.find("strip_time").keyframe_points
