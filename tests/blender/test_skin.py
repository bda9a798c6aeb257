"""LODs that heed the poses of the action: Blender's own evaluation is the judge."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.deviation import poses
from crowd_lod_extension.operators.levels import make_levels
from crowd_lod_extension.operators.populate import groups_of
from crowd_lod_extension.operators.skin import skin_of
from crowd_lod_extension.operators.source import read_source

from .characters import character, new, rig, skin, tube


def arm():
    armature = rig()
    item = new("arm", tube("arm"))
    skin(item, armature)
    character(item, armature, name="arm")
    return item


@pytest.mark.usefixtures("exact_levels")
def test_points_move_as_blender_moves_a_mesh_with_the_same_weights():
    item = arm()
    source, before = read_source(item), set(bpy.data.user_map())
    frames = poses([item])
    assert len(list(skin_of(source, frames))) == len(frames) > 8
    assert set(bpy.data.user_map()) == before  # nothing is left behind
    rng = np.random.default_rng(0)
    follows = rng.integers(0, len(source.geometry[0]), 100)
    at = source.geometry[0][follows] + rng.normal(0, 0.05, (100, 3))
    mesh = bpy.data.meshes.new("others")
    mesh.from_pydata(at.tolist(), [], [])
    other = item.copy()
    other.data = mesh
    names = [group.name for group in item.vertex_groups]
    for name in names:
        other.vertex_groups.new(name=name)
    for j, i in enumerate(follows):
        for given in item.data.vertices[int(i)].groups:
            other.vertex_groups[names[given.group]].add([j], given.weight, "REPLACE")
    scene = bpy.context.scene
    scene.collection.objects.link(other)
    for j, frame in enumerate(frames):
        scene.frame_set(int(frame // 1), subframe=float(frame % 1))
        evaluated = other.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        wanted = np.array([v.co for v in evaluated.vertices])
        np.testing.assert_allclose(source.skin.at(j, at.T, follows).T, wanted, atol=1e-4)  # float32, divided by a step of 1 %
    assert np.ptp(source.skin.place, axis=0).max() > 0.5


def test_what_nothing_deforms_has_no_skin():
    item = new("post", tube("post"))
    character(item)
    source = read_source(item)
    assert list(skin_of(source, [1.0, 2.0])) == [] and source.skin is None


def test_lods_bend_as_the_character_does():
    item = arm()
    settings = bpy.context.scene.crowd_lod
    found = {}
    for way in ("FAST", "PRECISE"):
        settings.way = way
        list(make_levels(bpy.context.scene))
        (group,) = groups_of(settings)
        found[way] = group.deviations
        for k, level in enumerate(settings.levels.children):  # at rest all are as close as ever
            (lod,) = level.all_objects
            near = io.read_triangles(lod.data)[0]
            assert np.abs(np.hypot(near[:, 0], near[:, 1]) - 0.2).max() < 0.03, (way, k)
    assert found["FAST"][1] == pytest.approx(0, abs=0.01)
    assert all(fast < precise / 2 for fast, precise in zip(found["FAST"][1:], found["PRECISE"][1:], strict=True)), found
    assert item.data.vertices and item.name == "arm"
