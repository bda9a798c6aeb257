"""LODs that heed the poses of the action: Blender's own evaluation is the judge."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.lods.poses import choose_poses, skin_of
from crowd_lod_extension.operators.lods.source_mesh import read_source
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of

from ..support.characters import character, new, rigged, tube
from ..support.objects import mesh_of


def arm():
    item, armature = rigged("arm")
    character(item, armature, name="arm")
    return item


def test_points_move_as_blender_moves_a_mesh_with_the_same_weights():
    item = arm()
    source = read_source(item)
    before = set(bpy.data.user_map())
    frames = finished(choose_poses([item]))
    assert len(list(skin_of(source, frames))) == len(frames) > 8
    assert set(bpy.data.user_map()) == before  # nothing is left behind
    rng = np.random.default_rng(0)
    follows = rng.integers(0, len(source.geometry.points), 100)
    at = source.geometry.points[follows] + rng.normal(0, 0.05, (100, 3))
    mesh = mesh_of("others", at)
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
        np.testing.assert_allclose(
            source.skin.at(j, at.T, follows).T, wanted, atol=1e-4
        )  # float32, divided by a step of 1 %
    assert np.ptp(source.skin.place, axis=0).max() > 0.5


def test_what_nothing_deforms_has_no_skin():
    item = new("post", tube("post"))
    character(item)
    source = read_source(item)
    assert list(skin_of(source, [1.0, 2.0])) == [] and source.skin is None


@pytest.mark.once
def test_lods_bend_as_the_character_does():
    item = arm()
    settings = bpy.context.scene.crowd_lod
    settings.level_count = 2
    list(make_levels(bpy.context.scene))
    (group,) = groups_of(settings)
    for k, level in enumerate(settings.levels.children):  # at rest all are as close as ever
        (lod,) = level.all_objects
        near = mesh_data.read_mesh(lod.data).points
        assert np.abs(np.hypot(near[:, 0], near[:, 1]) - 0.2).max() < 0.03, k
    assert group.deviations[1] == pytest.approx(0, abs=0.01)
    assert item.data.vertices and item.name == "arm"


def bowed(keyed=True):
    """An upright tube without an armature that a shape key, of 12 frames, bends into an arc, and
    another lets lean.
    """
    item = new("trunk", tube("trunk", around=16, along=24))
    character(item, name="trunk")
    item.shape_key_add(name="Basis", from_mix=False)
    rest = mesh_data.read_mesh(item.data).points
    x, y, z = rest.T
    arc = 0.8 * z
    reach = y + 1 / 0.8
    shapes = {
        "bow": np.column_stack([x, reach * np.cos(arc) - 1 / 0.8, reach * np.sin(arc)]),
        "lean": rest + np.outer(z, (0.2, 0, 0)),
    }
    for name, points in shapes.items():
        key = item.shape_key_add(name=name, from_mix=False)
        key.data.foreach_set("co", points.astype(np.float32).ravel())
        for frame, value in ((1, 0.0), (12, 1.0 if keyed else 0.0)):
            key.value = value
            key.keyframe_insert("value", frame=frame)
    return item


@pytest.mark.once
def test_a_shape_key_that_bends_counts_as_a_pose():
    bowed()
    settings = bpy.context.scene.crowd_lod
    settings.level_count = 2
    list(make_levels(bpy.context.scene))
    assert max(groups_of(settings)[0].deviations) < 0.02


@pytest.mark.once
def test_offsets_of_shape_keys_are_those_at_the_place_of_each_point():
    """What grows with the height is right at each height, not that of the nearest vertex."""
    bowed()
    list(make_levels(bpy.context.scene))
    for level in list(bpy.context.scene.crowd_lod.levels.children)[1:]:
        keys = level.all_objects[0].data.shape_keys.key_blocks
        rest, lean = (
            np.array([point.co for point in keys[name].data]) for name in ("Basis", "lean")
        )
        np.testing.assert_allclose(lean - rest, np.outer(rest[:, 2], (0.2, 0, 0)), atol=1e-3)


def test_keys_that_nothing_moves_count_at_their_full_value():
    item = bowed(keyed=False)
    source = read_source(item)
    list(skin_of(source, [1.0, 6.0, 12.0]))
    rest = source.geometry.points
    assert len(source.skin.place) == 5 and np.abs(source.skin.place[:3] - rest).max() == 0
    for place, name in zip(source.skin.place[3:], ("bow", "lean"), strict=True):
        np.testing.assert_allclose(
            place, [point.co for point in item.data.shape_keys.key_blocks[name].data], atol=1e-6
        )
    assert source.telling is not None


def test_poses_of_shape_keys_are_told_apart():
    """A key that rises between frames 20 and 24 of 60: poses are there, where the character
    changes.
    """
    item = bowed()
    for curve in (
        item.data.shape_keys.animation_data.action.layers[0].strips[0].channelbags[0].fcurves
    ):
        curve.keyframe_points[0].co.x = 20
        curve.keyframe_points[1].co.x = 24
        curve.keyframe_points[0].interpolation = "LINEAR"
    item["clock"] = 0.0
    for frame in (1, 60):
        item.keyframe_insert('["clock"]', frame=frame)
    found = finished(choose_poses([item]))
    assert sum(19.5 < frame < 24.5 for frame in found) >= 3, found
