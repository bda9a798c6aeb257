"""What hangs on a character outside its collection is told, and taken along."""

import bpy
import pytest

from ..support.characters import character, new, rigged, tube
from ..support.messages import told


@pytest.fixture
def shot(small_shot):
    body, armature = rigged("body", 8, 6, rig_name="Anna")
    character(armature, body, name="Anna")
    bpy.context.view_layer.update()
    return small_shot


def on_bone(scene):
    hat = new("Hat", tube("hat", 6, 4))
    hat.parent, hat.parent_type, hat.parent_bone = scene.objects["Anna"], "BONE", "upper"
    return hat


def on_constraint(scene):
    hat = new("Hat", tube("hat", 6, 4))
    hat.constraints.new("CHILD_OF").target = scene.objects["Anna"]
    return hat


def bound(scene):
    hat = new("Hat", tube("hat", 6, 4))
    hat.modifiers.new("Armature", "ARMATURE").object = scene.objects["Anna"]
    return hat


def hair(scene):
    hair = new("Hat", bpy.data.hair_curves.new("hair"))
    hair.data.add_curves([3])
    hair.data.surface = scene.objects["body"]
    return hair


@pytest.mark.parametrize("hanging", [on_bone, on_constraint, bound, hair])
def test_what_hangs_outside_is_told_and_taken_along(shot, hanging):
    hat = hanging(shot)
    shot.collection.objects.link(hat)
    hat.hide_render = True
    bpy.ops.crowd_lod.populate()
    assert "hangs on" not in told(shot)  # renders do not show it
    hat.hide_render = False
    bpy.ops.crowd_lod.populate()
    assert (
        "Hat (on Anna) hangs on a character outside its collection, so no agent wears it: press "
        "Take Along." in told(shot)
    )
    bpy.ops.crowd_lod.take_along()
    assert [home.name for home in hat.users_collection] == ["Anna"] and "Hat" not in told(shot)
    bpy.ops.crowd_lod.populate()
    assert "hangs on" not in told(shot)
    with pytest.raises(RuntimeError, match="Nothing hangs on a character"):
        bpy.ops.crowd_lod.take_along()
