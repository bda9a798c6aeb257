"""Characters stand where their rig or mesh does, wherever that is in the scene."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.build.shelves import points_of
from crowd_lod_extension.operators.scene.characters.characters import characters_of

from ..support.characters import character, rigged
from ..support.messages import told

PLACES = {"Anna": (5, 0, 0), "Bert": (-5, 3, 0)}


def person(name, place):
    body, armature = rigged(f"{name}'s body", 8, 6, rig_name=name)
    armature.location = place
    return armature, body


@pytest.fixture
def shot(small_shot):
    """A scene whose characters stand off its origin, in collections without an offset."""
    for name, place in PLACES.items():
        character(*person(name, place), name=name)
    small_shot.crowd_lod.choice = "BY_DISTANCE"
    small_shot.crowd_lod.level_count = 2
    bpy.context.view_layer.update()
    return small_shot


def farthest_body(scene):
    """How far a body of the build is from the nearest agent's place, meters, at most."""
    build = scene.crowd_lod.build
    columns = [mesh_data.read_points(points.data) for points in points_of(build).values()]
    places = np.concatenate([each["position"][:, :2] for each in columns if "id" in each])
    farthest = 0.0
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.is_instance and instance.parent.original in set(build.all_objects):
            mesh = instance.object.data
            points = np.array([instance.matrix_world @ vertex.co for vertex in mesh.vertices])
            # the lower half does not bend
            middle = points[points[:, 2] < 0.6].mean(axis=0)
            farthest = max(farthest, np.hypot(*(places - middle[:2]).T).min())
    return farthest


def test_bodies_stand_on_their_agents_live_and_baked(shot):
    bpy.ops.crowd_lod.populate()
    assert [group.radius < 1.3 for group in shot.crowd_lod.groups] == [True, True]
    bpy.ops.crowd_lod.build()
    assert farthest_body(shot) < 0.05
    bpy.ops.crowd_lod.make_levels()
    for make in (bpy.ops.crowd_lod.build, bpy.ops.crowd_lod.bake):
        make()
        shot.frame_set(3)
        assert farthest_body(shot) < 0.05


def test_an_offset_that_is_elsewhere_is_told(shot):
    bpy.ops.crowd_lod.populate()
    assert (
        "Anna (5 m), Bert (5.83 m) stand beside the Instance Offset of their collection, so their "
        "rig or mesh places the agents." in told(shot)
    )
    for home in shot.crowd_lod.characters.children:
        home.instance_offset = PLACES[home.name]
    bpy.ops.crowd_lod.populate()
    assert "Instance Offset" not in told(shot)


def test_characters_from_selection_find_the_same_place(shot):
    found = dict((name, origin) for name, _, origin in characters_of(shot))
    shot.crowd_lod.characters = None
    for item in shot.objects:
        item.select_set(item.type == "ARMATURE")
    bpy.ops.crowd_lod.characters_from_selection()
    homes = shot.crowd_lod.characters.children
    assert {home.name.removesuffix(".001"): tuple(home.instance_offset) for home in homes} == found
    assert found == PLACES


def test_the_place_is_the_same_in_all_frames(shot):
    anna = shot.objects["Anna"]
    for frame, y in ((1, 2.0), (10, 9.0)):
        anna.location.y = y
        anna.keyframe_insert("location", frame=frame)
    for frame in (10, 4):
        shot.frame_set(frame)
        ((_, _, origin), _) = characters_of(shot)
        assert origin == pytest.approx((5, 2, 0), abs=1e-5)


def test_of_two_rigs_the_larger_ones_place_counts_in_all_frames(shot):
    home = shot.crowd_lod.characters.children["Anna"]
    armature, tail = person("Tail", (5.4, 0, 0))
    for vertex in tail.data.vertices:
        vertex.co *= 0.9
    for frame, angle in ((1, 0.0), (10, 2.0)):
        armature.rotation_euler.x = angle
        armature.keyframe_insert("rotation_euler", frame=frame)
    for item in (armature, tail):
        home.objects.link(item)
    for frame in (1, 6, 10):
        shot.frame_set(frame)
        assert characters_of(shot)[0][2] == (5, 0, 0)


@pytest.mark.parametrize("of", ["rig", "mesh"])
def test_a_body_whose_location_was_applied_stands_in_its_middle(small_shot, of):
    armature, body = person("Carl", (0, 0, 0))
    if of == "rig":
        small_shot.collection.objects.link(armature)
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        for bone in armature.data.edit_bones:
            bone.head.x += 7
            bone.tail.x += 7
        bpy.ops.object.mode_set(mode="OBJECT")
        small_shot.collection.objects.unlink(armature)
    else:
        body.modifiers.clear()
        body.parent = None
    for vertex in body.data.vertices:
        vertex.co.x += 7
    character(*((armature, body) if of == "rig" else (body,)), name="Carl")
    bpy.context.view_layer.update()
    ((_, _, origin),) = characters_of(small_shot)
    assert origin == pytest.approx((7, 0, 0), abs=1e-5)
