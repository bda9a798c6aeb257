"""A character may have any modifier and any constraint that Blender knows, from Populate to Bake."""

import bpy
import pytest
from crowd_lod_extension.operators.blender.scene_data import set_node_input
from crowd_lod_extension.operators.build import staleness
from crowd_lod_extension.operators.crowd import cast_provenance

from ..support.characters import character, new, rig, skin, tube

INPUTS = {
    "Float": (1.0, 2.0),
    "Int": (1, 2),
    "Bool": (False, True),
    "Vector": ((1.0, 0.0, 0.0), (1.0, 0.0, 3.0)),
    "Color": ((1.0, 0.0, 0.0, 1.0), (1.0, 0.5, 0.0, 1.0)),
    "String": ("a", "b"),
}


def kinds(enum, owner):
    """The types that `enum`, an RNA function's argument, offers."""
    return [item.identifier for item in owner.bl_rna.functions["new"].parameters["type"].enum_items]


@pytest.fixture
def crowd():
    """A scene with a camera, in which 6 agents are to be."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 80, 45
    scene.frame_start, scene.frame_end = 1, 2
    scene.camera = new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location, scene.camera.rotation_euler = (0, -25, 2), (1.5, 0, 0)
    settings = scene.crowd_lod
    settings.count, settings.size, settings.method = 6, (10, 10), "DECIMATE"
    return scene


def nodes_modifier(item):
    """A Nodes modifier whose group has an input of each kind and hands the geometry on."""
    group = bpy.data.node_groups.new("Group", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    for kind in (*INPUTS, "Object"):
        group.interface.new_socket(kind, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    group.links.new(group.nodes.new("NodeGroupInput").outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    modifier = item.modifiers.new("Nodes", "NODES")
    modifier.node_group = group
    bpy.context.view_layer.update()
    return modifier


def press_buttons():
    """Press those from Populate to Bake; Blender raises the sentence of one that fails."""
    for name in ("populate", "make_levels", "estimate", "build", "bake"):
        assert getattr(bpy.ops.crowd_lod, name)() == {"FINISHED"}, name


def test_a_changed_input_of_nodes_makes_the_build_ask_for_update(crowd, monkeypatch):
    monkeypatch.setattr(staleness, "LOOK", 0.0)
    monkeypatch.setattr(cast_provenance, "PAUSE", 0.0)
    item = new("body", tube("body", 6, 3))
    character(item)
    modifier = nodes_modifier(item)
    for kind, (value, _) in INPUTS.items():
        set_node_input(modifier, kind, value)
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    assert staleness.changed(crowd) == []
    for kind, (before, after) in INPUTS.items():
        set_node_input(modifier, kind, after)
        assert "the character body" in staleness.changed(crowd), kind
        set_node_input(modifier, kind, before)
        assert staleness.changed(crowd) == [], kind
    set_node_input(modifier, "Object", crowd.camera)
    assert "the character body" in staleness.changed(crowd)


def test_an_animated_input_of_nodes_is_no_edit(crowd, monkeypatch):
    monkeypatch.setattr(staleness, "LOOK", 0.0)
    monkeypatch.setattr(cast_provenance, "PAUSE", 0.0)
    item = new("body", tube("body", 6, 3))
    character(item)
    modifier = nodes_modifier(item)
    path = next(s.identifier for s in modifier.node_group.interface.items_tree if s.name == "Float")
    path = f'["{path}"]' if bpy.app.version < (5, 2, 0) else f".properties.inputs.{path}.value"
    for frame in (1, 20):
        set_node_input(modifier, "Float", float(frame))
        assert item.keyframe_insert(f'modifiers["Nodes"]{path}', frame=frame)
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    for frame in (1, 7, 20):
        crowd.frame_set(frame)
        assert staleness.changed(crowd) == []


def test_every_modifier_goes_from_populate_to_bake(crowd):
    items = []
    for kind in kinds("type", bpy.types.ObjectModifiers):
        item = new(kind, tube(kind, 4, 2))
        if item.modifiers.new(kind, kind) is not None:
            items.append(item)
    assert len(items) > 50
    character(*items)
    press_buttons()


@pytest.mark.parametrize("on", ("object", "bone"))
def test_every_constraint_goes_from_populate_to_bake(crowd, on):
    items, target = [], new("target", None)
    crowd.collection.objects.link(target)
    armature = rig()
    owners = {"object": bpy.types.ObjectConstraints, "bone": bpy.types.PoseBoneConstraints}
    for kind in kinds("type", owners[on]):
        item = new(kind, tube(kind, 4, 2))
        owner = item if on == "object" else armature.pose.bones["upper"]
        constraint = owner.constraints.new(kind)
        if hasattr(constraint, "target"):
            constraint.target = armature if on == "object" and kind == "ARMATURE" else target
        constraint.influence = 0.0
        items.append(item)
    if on == "bone":
        skin(items[0], armature)
        items = [items[0], armature]
    character(*items)
    press_buttons()
