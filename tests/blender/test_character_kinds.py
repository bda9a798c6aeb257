"""A character may have any modifier, constraint and kind of data that Blender knows, by whatever
button.
"""

import bpy
import pytest
from crowd_lod_extension.operators.blender.scene_data import set_node_input

from ..support.characters import character, new, rig, skin, tube
from ..support.freshness import changed_since_build
from ..support.nodes import BLOCKS, INPUTS, nodes_modifier

pytestmark = pytest.mark.usefixtures("rough_lods")


def test_a_changed_input_of_nodes_makes_the_build_ask_for_update(small_shot, at_once):
    item = new("body", tube("body", 6, 3))
    character(item)
    modifier = nodes_modifier(item)
    blocks = (
        bpy.data.collections.new("Others"),
        bpy.data.materials.new("red"),
        bpy.data.images.new("map", 8, 8),
    )
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    assert changed_since_build(small_shot) == []
    for kind, (before, after) in INPUTS.items():
        set_node_input(modifier, kind, after)
        assert "the character someone" in changed_since_build(small_shot), kind
        set_node_input(modifier, kind, before)
        assert changed_since_build(small_shot) == [], kind
    for kind, block in zip(BLOCKS, (small_shot.camera, *blocks), strict=True):
        set_node_input(modifier, kind, block)
        assert "the character someone" in changed_since_build(small_shot), kind
        set_node_input(modifier, kind, None)
        assert changed_since_build(small_shot) == [], kind


def test_an_animated_input_of_nodes_is_no_edit(small_shot, at_once):
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
        small_shot.frame_set(frame)
        assert changed_since_build(small_shot) == []


def kinds(function):
    """The types that the argument `type` of an RNA function offers."""
    return [item.identifier for item in function.parameters["type"].enum_items]


def with_modifiers():
    """A tube for each type of modifier."""
    items = []
    for kind in kinds(bpy.types.ObjectModifiers.bl_rna.functions["new"]):
        item = new(kind, tube(kind, 3, 1))
        if item.modifiers.new(kind, kind) is not None:
            items.append(item)
    assert len(items) > 50
    return items


CURVES = "CLAMP_TO", "FOLLOW_PATH", "SPLINE_IK"  # constraints whose target is a curve
RIGS = "ARMATURE", "ACTION"


def with_constraints():
    """A tube for each type of constraint, and a skinned one with its rig, whose bone has them all;
    their targets are outside.
    """
    armature = rig()
    items = []
    targets = new("mesh", tube("mesh", 3, 1)), new("path", curve()), rig("other")
    for target in targets:
        target.location = (0, 3, 1)
    bone = armature.pose.bones["upper"]
    added = [
        bone.constraints.new(kind)
        for kind in kinds(bpy.types.PoseBoneConstraints.bl_rna.functions["new"])
    ]
    for kind in kinds(bpy.types.ObjectConstraints.bl_rna.functions["new"]):
        items.append(new(kind, tube(kind, 3, 1)))
        added.append(items[-1].constraints.new(kind))
    for constraint in added:
        target = targets[1 if constraint.type in CURVES else 2 if constraint.type in RIGS else 0]
        if hasattr(constraint, "target"):
            constraint.target = target
        elif hasattr(constraint, "targets"):
            constraint.targets.new().target = target
    body = new("skinned", tube("skinned", 3, 2))
    skin(body, armature)
    targets[2].animation_data_clear()
    return items, [body, armature]


def curve(kind="POLY"):
    data = bpy.data.curves.new(kind, "CURVE")
    data.splines.new(kind).points.add(1)
    data.splines[0].points[1].co = (0, 0, 2, 1)
    data.dimensions = "3D"
    return data


def with_faces():
    """A curve, a text and a surface, which have faces though they are no meshes."""
    bevelled = curve()
    text = bpy.data.curves.new("text", "FONT")
    bevelled.bevel_depth = 0.2
    text.body = "A"
    bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    surface = bpy.context.object
    surface.data.resolution_u = surface.data.resolution_v = 1
    bpy.context.scene.collection.objects.unlink(surface)
    return [new("bevelled", bevelled), new("text", text), surface]


def without_faces():
    """One of each kind of object that has no faces: name -> object."""
    data = bpy.data
    hair = data.hair_curves.new("hair")
    cloud = data.pointclouds.new("cloud")
    hair.add_curves([3])
    hair.position_data.foreach_set("vector", [0, 0, 0, 0, 0, 1, 0, 0, 2])
    bpy.ops.object.grease_pencil_add(type="STROKE")
    drawing = bpy.context.object
    drawing.name = "drawing"
    bpy.context.scene.collection.objects.unlink(drawing)
    blocks = {
        "hair": hair,
        "cloud": cloud,
        "volume": data.volumes.new("volume"),
        "wire": curve(),
        "lattice": data.lattices.new("lattice"),
        "armature": data.armatures.new("armature"),
        "lamp": data.lights.new("lamp", "POINT"),
        "camera": data.cameras.new("camera"),
        "speaker": data.speakers.new("speaker"),
        "probe": data.lightprobes.new("probe", "SPHERE"),
        "empty": None,
    }
    return {name: new(name, block) for name, block in blocks.items()} | {"drawing": drawing}


BUTTONS = (
    "populate",
    "make_levels",
    "estimate",
    "plan_shot",
    "build",
    "bake",
    "preview",
    "verify",
    "export_usd",
    "remove_build",
)


def test_all_kinds_of_characters_go_through_all_buttons(small_shot, tmp_path, capfd):
    constrained, skinned = with_constraints()
    character(*with_modifiers(), name="modifiers")
    character(*constrained, name="constraints")
    character(*skinned, name="bones")
    character(
        *with_faces(), new("body", tube("body", 3, 1)), *without_faces().values(), name="kinds"
    )
    settings = small_shot.crowd_lod
    settings.level_count = 2
    settings.width = 32
    settings.verify_count = 1
    settings.output_folder = str(tmp_path)
    for name in BUTTONS:
        assert getattr(bpy.ops.crowd_lod, name)() == {"FINISHED"}, name
    told = "Not included: cloud (point cloud), drawing (Grease Pencil), volume (volume)."
    assert told in capfd.readouterr().out  # of Populate


def test_a_character_without_faces_is_refused_by_name(small_shot):
    for name, item in without_faces().items():
        home = character(item, name=f"the {name}")
        with pytest.raises(
            RuntimeError, match=f"the {name}|holds lamps, cameras and empties alone"
        ):
            bpy.ops.crowd_lod.populate()
            bpy.ops.crowd_lod.make_levels()
        bpy.data.collections.remove(home)


def test_what_a_constraint_puts_at_nan_is_refused_by_name(small_shot):
    item = new("stretched", tube("stretched", 3, 1))
    target = new("target", None)
    item.constraints.new("STRETCH_TO").target = target  # from a place to the same place
    character(new("body", tube("body", 3, 1)), item)
    with pytest.raises(
        RuntimeError, match="The object stretched has points at NaN or infinity in its action"
    ):
        bpy.ops.crowd_lod.populate()
