"""Modifiers, shape keys and armatures of characters: a LOD follows what deforms its source."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import mesh_data

from ..support.characters import character, new, rig, skin, tube
from .test_level_sources import make_lods, world

pytestmark = pytest.mark.usefixtures("rough_lods")


def test_faces_that_only_a_modifier_makes_count():
    line = bpy.data.meshes.new("line")
    line.from_pydata([(1, 0, z) for z in np.linspace(0, 2, 9)], [(i, i + 1) for i in range(8)], [])
    item = new("vase", line)
    screw = item.modifiers.new("Screw", "SCREW")
    screw.steps = screw.render_steps = 32
    character(item)
    lods = make_lods(2)
    count = mesh_data.count_triangles(lods["vase LOD 1"].data)
    assert count == pytest.approx(0.12 * 8 * 32 * 2, rel=0.2)
    assert np.abs(np.linalg.norm(world(lods["vase LOD 1"])[:, :2], axis=1) - 1).max() < 0.15


@pytest.mark.once
def test_shape_keys_that_move_are_kept_through_modifiers_and_driven_by_the_characters_own():
    item = new("body", tube("body", 16, 8))
    item.shape_key_add(name="Basis")
    for name, factor in (("fat", 2.0), ("idle", 3.0)):
        key = item.shape_key_add(name=name)
        key.value = 0
        points = np.empty((len(item.data.vertices), 3), np.float32)
        item.data.vertices.foreach_get("co", points.ravel())
        key.data.foreach_set("co", (points * (factor, factor, 1)).astype(np.float32).ravel())
    fat = item.data.shape_keys.key_blocks["fat"]
    for frame, value in ((1, 0.0), (10, 1.0)):
        fat.value = value
        fat.keyframe_insert("value", frame=frame)
    item.modifiers.new("Subdivision", "SUBSURF").levels = 1
    character(item)
    lod = make_lods()["body LOD 1"]
    assert lod.data.shape_keys.key_blocks.keys() == ["Basis", "fat"]
    for frame, radius in ((1, 0.2), (10, 0.4)):
        bpy.context.scene.frame_set(frame)
        assert np.linalg.norm(world(lod)[:, :2], axis=1).max() == pytest.approx(radius, rel=0.03)


def test_vertex_groups_of_what_nodes_join_keep_their_names():
    donor = new("donor", tube("donor", 8, 8))
    for name in ("a", "b", "c"):
        donor.vertex_groups.new(name=name)
    tree = bpy.data.node_groups.new("join", "GeometryNodeTree")
    for way_in in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way_in, socket_type="NodeSocketGeometry")
    kinds = (
        "NodeGroupInput",
        "NodeGroupOutput",
        "GeometryNodeObjectInfo",
        "GeometryNodeJoinGeometry",
    )
    begin, end, other, join = (tree.nodes.new(kind) for kind in kinds)
    other.inputs[0].default_value = donor
    for one, two in (
        (other.outputs["Geometry"], join.inputs[0]),
        (begin.outputs[0], join.inputs[0]),
        (join.outputs[0], end.inputs[0]),
    ):
        tree.links.new(one, two)
    armature = rig()
    body = new("body", tube("body", 8, 8))
    body.modifiers.new("Join", "NODES").node_group = tree
    skin(body, armature)
    character(body)
    lod = make_lods()["body LOD 1"]
    of = {group.index: group.name for group in lod.vertex_groups}
    assert set(of.values()) == {"a", "b", "c", "lower", "upper"}
    top = [
        {of[entry.group] for entry in vertex.groups if entry.weight > 0}
        for vertex in lod.data.vertices
        if vertex.co.z > 1.9
    ]
    assert {"upper"} in top and all(names <= {"upper"} for names in top)


def test_modifiers_count_as_they_are_rendered():
    for name, seen, rendered in (
        ("both", True, True),
        ("drawn", True, False),
        ("rendered", False, True),
    ):
        item = new(name, tube(name, 8, 8))
        array = item.modifiers.new("Array", "ARRAY")
        array.show_viewport = seen
        array.show_render = rendered
        character(item, name=name)
    wide = {
        name: np.ptp(mesh_data.read_mesh(item.data).points[:, 0])
        for name, item in make_lods().items()
    }
    assert (
        wide["rendered LOD 1"]
        == pytest.approx(wide["both LOD 1"])
        == pytest.approx(2 * wide["drawn LOD 1"], rel=0.05)
    )
    assert all(group.deviations[1] < 0.05 for group in bpy.context.scene.crowd_lod.groups)


def test_what_is_shrunk_onto_a_body_is_so_at_rest():
    armature = rig()
    body = new("body", tube("body", 16, 16))
    shirt = new("shirt", tube("shirt", 16, 16, 0.22))
    for frame in (1, 10):
        armature.pose.bones["upper"].rotation_euler = (1.2, 0, 0)  # nowhere at rest
        armature.pose.bones["upper"].keyframe_insert("rotation_euler", frame=frame)
    for item in (body, shirt):
        skin(item, armature)
    wrap = shirt.modifiers.new("Shrinkwrap", "SHRINKWRAP")
    wrap.target = body
    wrap.offset = 0.02
    character(armature, body, shirt)
    low, high = (
        getattr(mesh_data.read_mesh(make_lods()["shirt LOD 1"].data).points, end)(axis=0)
        for end in ("min", "max")
    )
    assert np.allclose(low, (-0.22, -0.22, 0), atol=0.03) and np.allclose(
        high, (0.22, 0.22, 2), atol=0.03
    )
    assert armature.data.pose_position == "POSE"


def test_of_two_armatures_that_deform_it_in_turn_a_lod_follows_both():
    """A face's small weights are not cut for the sake of the body's."""
    body = rig("body rig")
    face = rig("face rig")
    for bone in face.data.bones:
        bone.name = f"face {bone.name}"
    item = new("body", tube("body"))
    skin(item, body)
    item.modifiers.new("Face", "ARMATURE").object = face
    for number in range(4):  # bones of the one that fill all four places
        item.vertex_groups.new(name=f"spare {number}").add(
            range(len(item.data.vertices)), 0.5, "REPLACE"
        )
    bpy.context.scene.collection.objects.link(body)
    bpy.context.view_layer.objects.active = body
    bpy.ops.object.mode_set(mode="EDIT")
    for number in range(4):
        body.data.edit_bones.new(f"spare {number}").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    item.vertex_groups.new(name="face upper").add(range(len(item.data.vertices)), 0.1, "REPLACE")
    character(body, face, item)
    lod = make_lods()["body LOD 1"]
    for vertex in lod.data.vertices:
        weights = {lod.vertex_groups[entry.group].name: entry.weight for entry in vertex.groups}
        assert (
            weights.pop("face upper") == pytest.approx(1)
            and sum(weights.values()) == pytest.approx(1)
            and len(weights) <= 4
        )
    assert bpy.context.scene.crowd_lod.groups[0].deviations[1] < 0.1
