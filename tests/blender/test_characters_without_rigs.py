"""Characters that no rig can show: they are posed, or carried as a whole, and it is said why."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.build.phase_characters import make_characters
from crowd_lod_extension.operators.build.shelves import SHELF
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.rig_needs import POSES
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.characters import armature_of
from ..support.objects import collection


def props(scene, *objects):
    """`scene` with a crowd of these objects, with their LODs, built.

    [the objects that agents show, in order].
    """
    top = collection("Props")
    scene.crowd_lod.characters = top
    scene.crowd_lod.level_count = 1
    group = collection("someone", within=top)
    for item in objects:
        for home in item.users_collection:
            home.objects.unlink(item)
        group.objects.link(item)
    store_groups(scene.crowd_lod, measure_groups(scene))
    list(make_levels(scene))
    list(render_setup.build(read_crowd(scene)))
    shelf = next(c for c in scene.crowd_lod.build.children_recursive if c.get(SHELF) == 0)
    assert not any(
        any(home.instance_offset) for home in shelf.children
    )  # geometry nodes would not heed it
    return [item for home in shelf.children for item in home.objects]


def turning_ball(turn=3.0):
    bpy.ops.mesh.primitive_uv_sphere_add()
    ball = bpy.context.object
    ball.name = "ball"
    for frame, angle in ((1, 0.0), (25, turn)):
        ball.rotation_euler.z = angle
        ball.keyframe_insert("rotation_euler", frame=frame)
    return ball


def test_what_no_rig_can_show_is_posed_and_keeps_what_materials_need(scene):
    ball = turning_ball()
    own = bpy.data.materials.new("own")
    other = bpy.data.materials.new("other")
    ball.data.materials.append(own)
    ball.material_slots[0].link = "OBJECT"
    ball.material_slots[0].material = other
    ball.parent = bpy.data.objects.new("pivot", None)
    ball.parent.scale = (1, 3, 1)  # the ball turns under it: a shear, which bones have not
    ball.parent.location = (3, -2, 0.7)  # where a character stands in the scene is no matter
    balls = props(scene, ball)
    assert list(scene.crowd_lod.build[render_setup.POSED]) == [POSES] and len(balls) == POSES
    assert (
        all(item.material_slots[0].material == other for item in balls)
        and ball.data.materials[0] == own
    )
    assert all(item.data.uv_layers and item.parent is None and not item.modifiers for item in balls)
    low = scene.crowd_lod.groups[0].lowest
    for j in (0, 7, 20):
        scene.frame_set(1 + int(24 * j / POSES), subframe=24 * j / POSES % 1)
        wanted = mesh_data.world_points(
            ball.evaluated_get(bpy.context.evaluated_depsgraph_get())
        ) - (3, -2, low)
        points = np.array([vertex.co for vertex in balls[j].data.vertices])
        matrix = np.array(balls[j].matrix_basis)
        np.testing.assert_allclose(points @ matrix[:3, :3].T + matrix[:3, 3], wanted, atol=1e-5)


@pytest.mark.parametrize("why", ["shape keys", "cloth", "bendy bones"])
def test_why_a_character_is_posed_is_said(scene, why):
    ball = turning_ball()
    if why == "shape keys":
        ball.shape_key_add(name="Basis")
        ball.shape_key_add(name="flat").data[0].co.z = 3
        ball.data.shape_keys.key_blocks["flat"].keyframe_insert("value", frame=1)
    elif why == "cloth":
        ball.modifiers.new("Cloth", "CLOTH")
    else:
        rig = armature_of("rig", {"bone": ((0, 0, 0), (0, 0, 1), None)})
        rig.data.bones["bone"].bbone_segments = 4
        ball.vertex_groups.new(name="bone").add(range(40), 1.0, "REPLACE")
        ball.modifiers.new("rig", "ARMATURE").object = rig
    props(scene, ball)
    built = finished(make_characters(read_crowd(scene)))
    said = render_setup.notes_on_built(read_crowd(scene), built)
    assert list(built.posed) == [POSES] and why in said.lower()
    assert "each of which stands for 0.75 frames (0.0312 s) of its action" in said
    bpy.data.batch_remove(list(built.names))


def test_bones_that_shear_are_shown_as_near_as_can_be_and_it_is_said(scene):
    """A bone below one that is scaled along one axis, and turns: its matrix is a shear, which a
    bone of its own cannot have.
    """
    bones = {"root": ((0, 0, 0), (0, 0, 1), None), "tip": ((0, 0, 1), (0, 0, 2), "root")}
    rig = armature_of("rig", bones)
    rig.pose.bones["root"].scale = (1.0, 1.03, 1.0)
    tip = rig.pose.bones["tip"]
    tip.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (25, 1.5)):
        tip.rotation_euler.z = angle
        tip.rotation_euler.x = angle
        tip.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.mesh.primitive_uv_sphere_add(location=(0, 0, 1.5))
    ball = bpy.context.object
    ball.vertex_groups.new(name="tip").add(range(len(ball.data.vertices)), 1.0, "REPLACE")
    ball.modifiers.new("rig", "ARMATURE").object = rig
    props(scene, ball)
    notes = finished(make_characters(read_crowd(scene))).notes
    assert list(scene.crowd_lod.build[render_setup.POSED]) == [0]
    assert len(notes) == 1 and "are off by up to 0." in notes[0]


def test_objects_that_move_as_a_whole_are_carried(scene):
    """A text, with its own material and custom property, and the hair on it, whose parent it is."""
    words = bpy.data.curves.new("words", "FONT")
    words.body = "Hi"
    words.extrude = 0.1
    sign = bpy.data.objects.new("sign", words)
    words.materials.append(bpy.data.materials.new("shared"))
    sign.material_slots[0].link = "OBJECT"
    sign.material_slots[0].material = bpy.data.materials.new("own")
    sign.visible_shadow = False
    sign["looks"] = 3
    hair = bpy.data.objects.new("hair", bpy.data.hair_curves.new("hair"))
    hair.data.add_curves([4, 4])
    for frame, x in ((1, 0.0), (13, 3.0), (25, 0.0)):  # and back: a way would be taken out
        sign.location.x = x
        sign.keyframe_insert("location", frame=frame)
    hair.parent = sign
    items = props(scene, sign, hair)
    assert list(scene.crowd_lod.build[render_setup.POSED]) == [0]
    signs, hairs = ([item for item in items if kind in item.name] for kind in ("sign", "hair"))
    assert len(signs) == len(hairs) >= 16 and {item.type for item in hairs} == {"CURVES"}
    assert all(
        i.material_slots[0].material.name == "own" and not i.visible_shadow and i["looks"] == 3
        for i in signs
    )
    bpy.context.view_layer.depsgraph.update()
    stage = bpy.data.scenes.new("stage")
    for item in items:
        stage.collection.objects.link(item)
        stage.collection.objects.link(
            item.parent
        ) if item.parent.name not in stage.collection.objects else None
    stage.frame_set(7)
    depsgraph = stage.view_layers[0].depsgraph
    for own in (signs, hairs):
        x = np.array([item.evaluated_get(depsgraph).matrix_world.translation.x for item in own])
        assert np.ptp(x) > 2.0 and -0.1 < x.min() and x.max() < 3.1


@pytest.mark.usefixtures("rough_lods")
def test_a_group_that_stands_still_has_one_pose(scene):
    for rig in [o for o in scene.crowd_lod.characters.all_objects if o.type == "ARMATURE"]:
        rig.animation_data_clear()
    store_groups(scene.crowd_lod, measure_groups(scene))
    list(make_levels(scene))
    list(render_setup.build(read_crowd(scene)))
    assert list(scene.crowd_lod.build[render_setup.POSED]) == [1, 1]
    meshes = {item.data for c in scene.crowd_lod.build.children_recursive for item in c.objects}
    assert len(meshes) == 6
