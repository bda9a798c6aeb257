"""What moves a character: found wherever users put it, and noticed when it changes."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender.animation import action_range
from crowd_lod_extension.operators.blender.provenance import source_digest
from crowd_lod_extension.operators.lods.source_mesh import object_digest, read_source
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups

from ..support.characters import character, new, rig, rigged, skin, tube
from ..support.objects import placed
from ..support.rigs import keyed


def by_shape_key(body):
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="tall")
    key.data.foreach_set(
        "co",
        np.column_stack([np.zeros((len(key.data), 2)), np.linspace(0, 5, len(key.data))]).ravel(),
    )
    keyed(key, "value", 1.0, 20)


def by_strips(body):
    armature = rig()
    skin(body, armature)
    data = armature.animation_data
    action = data.action
    data.action = None
    strip = data.nla_tracks.new().strips.new("bend", 5, action)
    strip.frame_start = 5
    strip.frame_end = 14
    data.nla_tracks.new().strips.new("unused", 40, action).mute = True


def by_parent(body):
    grandparent = new("mover", None)
    body.parent = new("between", None)
    body.parent.parent = grandparent
    keyed(grandparent, "location", (3, 0, 0), 30)


def by_target(body):
    armature = rig()
    target = new("target", None)
    armature.animation_data_clear()
    skin(body, armature)
    armature.pose.bones["upper"].constraints.new("DAMPED_TRACK").target = target
    target.location = (0, 0, 3)
    keyed(target, "location", (3, 0, 1), 12)


@pytest.mark.parametrize(
    "by, expected",
    [(by_shape_key, (1, 20)), (by_strips, (5, 14)), (by_parent, (1, 30)), (by_target, (1, 12))],
)
def test_what_moves_a_character_is_its_action_and_in_its_sphere(by, expected):
    body = new("body", tube("body", 8, 8))
    radius = {}
    for moved in (False, True):
        if moved:
            by(body)
        else:
            character(body)
        radius[moved] = measure_groups(bpy.context.scene)[0].radius
    assert action_range([body]) == expected
    assert radius[True] > radius[False] + 0.01


def test_an_action_of_its_own_goes_before_what_it_follows():
    body, armature = rigged("body", 8, 8)
    armature.parent = new("turntable", None)
    keyed(armature.parent, "location", (3, 0, 0), 250)
    assert action_range([body]) == (1, 10)


def test_of_an_action_shared_by_slots_a_character_plays_its_own():
    """As a file of one action for many characters has it, since Blender 4.4."""
    body = new("body", tube("body", 8, 8))
    other = new("other", None)
    skin(body, rig())
    data = body.parent.animation_data
    strip = data.nla_tracks.new().strips.new("again", 20, data.action)
    own = digest(body)
    action = other.animation_data_create().action = data.action
    other.animation_data.action_slot = action.slots.new("OBJECT", "other")
    keyed(other, "location", (3, 0, 0), 400)
    assert action_range([body]) == (1, 29) and action_range([other]) == (1, 400)
    assert digest(body) == own
    action.use_frame_range = True
    action.frame_end = 6
    strip.mute = True
    assert action_range([body])[1] == 6 and digest(body) != own


@pytest.fixture
def body():
    item = new("body", tube("body", 8, 8))
    armature = rig()
    bpy.context.scene.collection.objects.link(armature)  # or it would be gone after saving
    skin(item, armature)
    item.data.uv_layers.new(name="second")
    item.modifiers.new("Subdivision", "SUBSURF").levels = 0
    character(item)
    bone = armature.pose.bones["upper"].constraints.new("COPY_ROTATION")
    bone.target = new("target", None)
    bone.influence = 0.0
    bpy.context.scene.collection.objects.link(bone.target)
    return item


def driven(body):
    """A constraint follows a custom property of the rig, as a Rigify rig's IK and FK do, and a bone
    an empty.
    """
    pose = body.parent.pose.bones
    empty = placed("handle")
    body.parent["ik"] = 0.0
    for curve, block, path in (
        (pose["upper"].constraints[0].driver_add("influence"), body.parent, '["ik"]'),
        (pose["lower"].driver_add("location", 0), empty, "location.x"),
    ):
        curve.driver.type, variable = "AVERAGE", curve.driver.variables.new()
        variable.targets[0].id = block
        variable.targets[0].data_path = path
    return empty, curve.driver


def digest(item):
    source = read_source(item)
    try:
        return object_digest(item, source)
    finally:
        bpy.data.meshes.remove(source.mesh)


def edit_rest(body):
    bpy.context.view_layer.objects.active = body.parent
    bpy.ops.object.mode_set(mode="EDIT")
    body.parent.data.edit_bones["upper"].head.x += 0.1
    bpy.ops.object.mode_set(mode="OBJECT")


def interpolate(body):
    action = body.parent.animation_data.action
    for curve in action.layers[0].strips[0].channelbags[0].fcurves:
        curve.keyframe_points[0].interpolation = "CONSTANT"


CHANGES = {
    "interpolation": interpolate,
    "deform": lambda body: setattr(body.parent.data.bones["upper"], "use_deform", False),
    "rest pose": edit_rest,
    "pose": lambda body: setattr(body.parent.pose.bones["lower"], "location", (0.1, 0, 0)),
    "preserve volume": lambda body: setattr(
        body.modifiers["Armature"], "use_deform_preserve_volume", True
    ),
    "influence": lambda body: setattr(
        body.parent.pose.bones["upper"].constraints[0], "influence", 0.5
    ),
    "target": lambda body: setattr(bpy.data.objects["target"], "location", (1, 0, 0)),
    "rendered levels": lambda body: setattr(body.modifiers["Subdivision"], "render_levels", 3),
    "active UV map": lambda body: setattr(body.data.uv_layers["second"], "active_render", True),
    "shadow": lambda body: setattr(body, "visible_shadow", False),
    "strips": by_strips,
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_lods_take_is_noticed(body, change):
    before = digest(body)
    CHANGES[change](body)
    assert digest(body) != before


def test_all_that_plays_an_action_otherwise_is_noticed(body):
    """Each of these moves the evaluated vertices of a character like this one."""
    data = body.parent.animation_data
    upper = body.parent.pose.bones["upper"]
    curve = data.action.layers[0].strips[0].channelbags[0].fcurves[0]
    first = curve.keyframe_points[0]
    noise = curve.modifiers.new("NOISE")
    lattice = new("cage", bpy.data.lattices.new("cage"))
    body.modifiers.new("Lattice", "LATTICE").object = lattice
    upper.constraints.new("IK").target = lattice
    found = [digest(body)]
    for change in (
        lambda: setattr(noise, "strength", 2),
        lambda: curve.modifiers.remove(noise),
        lambda: curve.modifiers.new("CYCLES"),
        lambda: setattr(curve, "mute", True),
        lambda: (
            setattr(curve, "mute", False),
            setattr(first, "interpolation", "ELASTIC"),
            setattr(first, "easing", "EASE_IN"),
        ),
        lambda: setattr(first, "amplitude", 3),
        lambda: setattr(
            upper, "rotation_mode", "QUATERNION"
        ),  # the action turns it by Euler angles
        lambda: setattr(upper, "scale", (1, 2, 1)),  # which the action does not set
        lambda: setattr(upper, "ik_stiffness_x", 0.9),
        lambda: setattr(body.parent.pose, "ik_solver", "ITASC"),
        lambda: setattr(lattice.data.points[0], "co_deform", (-2, -2, -2)),
        lambda: data.nla_tracks.new().strips.new("strip", 1, data.action),
        lambda: setattr(data, "action_blend_type", "ADD"),
        lambda: setattr(data.nla_tracks[0].strips[0], "use_reverse", True),
        lambda: setattr(data.nla_tracks[0].strips[0], "blend_in", 4),
        lambda: setattr(data.nla_tracks.new(), "is_solo", True),
    ):
        change()
        found.append(digest(body))
    assert len(set(found)) == 17


def test_what_drivers_read_is_noticed_unless_it_is_animated(body):
    empty, driver = driven(body)
    found = [digest(body)]
    for change in (
        lambda: body.parent.__setitem__("ik", 1.0),
        lambda: setattr(empty, "location", (0.5, 0, 0)),
        lambda: (setattr(driver, "type", "SCRIPTED"), setattr(driver, "expression", "2 * var")),
        lambda: keyed(empty, "location", (1, 0, 0), 30),
        lambda: [body.parent.keyframe_insert('["ik"]', frame=frame) for frame in (1, 10)],
    ):
        change()
        found.append(digest(body))
    assert len(set(found)) == 6
    body.parent["ik"] = 0.3
    body.parent["unread"] = 1
    empty.location = (0, 0, 0)
    assert digest(body) == found[-1]


def test_the_frame_what_panels_show_and_saving_change_nothing(body, tmp_path):
    constraint = body.parent.pose.bones["upper"].constraints[0]
    keyed(constraint, "influence", 1.0, 10)
    keyed(body, "location", (1, 0, 0), 10)
    bpy.context.scene.frame_set(1)
    before = digest(body)
    bpy.context.scene.frame_set(7)
    body.modifiers["Armature"].show_expanded = False
    assert digest(body) == before
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert digest(bpy.data.objects["body"]) == before


def made_of_much(item):
    """A textured Displace, a Hook with a curve, and nodes with a color ramp."""
    texture = bpy.data.textures.new("noise", "CLOUDS")
    item.modifiers.new("Displace", "DISPLACE").texture = texture
    hook = item.modifiers.new("Hook", "HOOK")
    hook.falloff_type = "CURVE"
    group = bpy.data.node_groups.new("Group", "GeometryNodeTree")
    item.modifiers.new("Nodes", "NODES").node_group = group
    ramp = group.nodes.new("ShaderNodeValToRGB")
    return texture, hook.falloff_curve.curves[0].points[0], ramp


def test_what_a_struct_owns_and_what_it_refers_to_counts_and_what_windows_show_does_not():
    item = new("body", tube("body", 8, 8))
    skin(item, rig())
    texture, point, ramp = made_of_much(item)
    found = [source_digest(item)]
    for change in (
        lambda: setattr(texture, "noise_scale", 3),
        lambda: setattr(point, "location", (0, 0.4)),
        lambda: setattr(ramp.color_ramp.elements[0], "position", 0.3),
        lambda: setattr(item.modifiers["Hook"], "show_render", False),
    ):
        change()
        found.append(source_digest(item))
    assert len(set(found)) == 5
    texture.name = "another"
    ramp.location = (300, 0)
    ramp.select = item.modifiers["Hook"].show_expanded = False
    item.hide_render = item.show_in_front = True
    item.parent.data.display_type = "STICK"
    assert source_digest(item) == found[-1]
