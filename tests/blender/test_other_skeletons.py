"""Actions that were made for another skeleton: turned over by a formula, or refused by name."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender.action_fit import fit_of
from crowd_lod_extension.operators.blender.named_actions import performance_of

from ..support.characters import armature_of, character, edited, new, skin, tube
from ..support.messages import told

# name -> (head, tail, parent): a person who holds out the arms
BODY = {
    "hips": ((0, 0, 1.0), (0, 0, 1.2), ""),
    "chest": ((0, 0, 1.2), (0, 0, 1.5), "hips"),
    "arm.L": ((0.2, 0, 1.5), (0.5, 0, 1.5), "chest"),
    "hand.L": ((0.5, 0, 1.5), (0.7, 0, 1.5), "arm.L"),
    "arm.R": ((-0.2, 0, 1.5), (-0.5, 0, 1.5), "chest"),
    "hand.R": ((-0.5, 0, 1.5), (-0.7, 0, 1.5), "arm.R"),
    "leg.L": ((0.1, 0, 1.0), (0.1, 0, 0.5), "hips"),
    "foot.L": ((0.1, 0, 0.5), (0.1, 0, 0), "leg.L"),
    "leg.R": ((-0.1, 0, 1.0), (-0.1, 0, 0.5), "hips"),
    "foot.R": ((-0.1, 0, 0.5), (-0.1, 0, 0), "leg.R"),
}
HANGING = {
    f"{part}.{side}": ((way * x, 0, z), (way * x, 0, z - length), parent.format(side))
    for side, way in (("L", 1), ("R", -1))
    for part, x, z, length, parent in (
        ("arm", 0.2, 1.5, 0.3, "chest"),
        ("hand", 0.2, 1.2, 0.2, "arm.{}"),
    )
}
FRAMES = (1, 4, 9, 17, 25)


def skeleton(name, bones=BODY, size=1.0, roll=0.0):
    sized = {
        bone: (np.multiply(head, size), np.multiply(tail, size), parent)
        for bone, (head, tail, parent) in bones.items()
    }
    armature = armature_of(name, sized)
    with edited(armature) as edit:
        for bone in edit:
            bone.roll += roll
    return armature


def moved(armature, name, mode="XYZ"):
    """Give the rig an action in which all limbs turn and the hips go up and down."""
    armature.animation_data_create().action = None
    for number, bone in enumerate(armature.pose.bones):
        bone.rotation_mode = mode
        for frame, angle in ((1, 0.3), (13, -0.5), (25, 0.3)):
            if mode == "XYZ":
                bone.rotation_euler = (angle, 0.1 * number * angle, angle / 2)
                bone.keyframe_insert("rotation_euler", frame=frame)
            else:
                bone.rotation_quaternion = (1, angle, 0.1 * number * angle, angle / 2)
                bone.keyframe_insert("rotation_quaternion", frame=frame)
    for frame, height in ((1, 0), (13, 0.1), (25, 0)):
        armature.pose.bones["hips"].location = (0.02, height, 0)
        armature.pose.bones["hips"].keyframe_insert("location", frame=frame)
    armature.animation_data.action.name = name
    return armature.animation_data.action


def keep(armature, action):
    """Keep the action with the rig as importers do: in a muted track."""
    track = armature.animation_data.nla_tracks.new()
    track.mute = True
    track.strips.new(action.name, 1, action)


def joints(armature, frame):
    """The places of the rig's joints at a frame, by bone."""
    bpy.context.scene.frame_set(frame)
    posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    return np.array([posed[name].head for name in BODY])


def person(armature, name):
    item = new(f"{name} body", tube(name, 8, 4))
    skin(item, armature)
    return character(item, name=name)


def take(armature, action=""):
    bpy.context.scene.crowd_lod.count = 2
    bpy.ops.crowd_lod.populate()
    return bpy.ops.crowd_lod.take_action(action=action)


@pytest.mark.parametrize("mode", ["XYZ", "QUATERNION"])
@pytest.mark.parametrize("plays", ["walk", "death"])
def test_bones_that_are_turned_otherwise_get_their_keys_turned_over(mode, plays):
    """However the one's bones turn, whatever it plays now, and by whatever channels."""
    one = skeleton("one")
    walk, death = (moved(one, name, mode) for name in ("one|walk", "one|death"))
    for action in (walk, death):
        keep(one, action)
    one.animation_data.action = {"walk": walk, "death": death}[plays]
    other = skeleton("other", roll=2.0)
    person(other, "someone")
    take(other)
    assert other.animation_data.action.name == "one|walk other"
    one.animation_data.action = walk
    assert (other.pose.bones["hips"].rotation_mode == "QUATERNION") and walk.users
    for frame in FRAMES:
        assert np.abs(joints(one, frame) - joints(other, frame)).max() < 2e-5


@pytest.mark.parametrize("size", [0.6, 100.0])
def test_a_smaller_skeleton_goes_as_far_for_its_size(size):
    one = skeleton("one")
    moved(one, "one|walk")
    other = skeleton("other", size=size)
    person(other, "someone")
    take(other)
    for frame in FRAMES:
        assert np.abs(size * joints(one, frame) - joints(other, frame)).max() < 2e-5 * size


def test_a_character_that_stands_otherwise_holds_its_arms_as_the_other_does():
    one = skeleton("one")
    moved(one, "one|walk")
    other = skeleton("other", BODY | HANGING)
    person(other, "someone")
    bpy.context.scene.crowd_lod.count = 2
    bpy.ops.crowd_lod.populate()
    assert {*fit_of(other, bpy.data.actions["one|walk"]).turned} == {"arm.L", "arm.R"}
    bpy.ops.crowd_lod.take_action()
    names = list(BODY)
    for frame in FRAMES:
        here, there = joints(one, frame), joints(other, frame)
        for side in "LR":
            arm, hand = names.index(f"arm.{side}"), names.index(f"hand.{side}")
            ways = [place[hand] - place[arm] for place in (here, there)]
            assert np.allclose(*ways, atol=1e-4)
        legs = [names.index(name) for name in ("leg.L", "foot.L", "leg.R", "foot.R")]
        assert np.abs(here[legs] - there[legs]).max() < 1e-4


def test_a_skeleton_whose_whole_space_is_turned_needs_the_whole_turn_alone():
    """As of an importer that makes armatures with Y up."""
    one = skeleton("one")
    moved(one, "one|walk")
    lying = {
        bone: ((head[0], head[2], -head[1]), (tail[0], tail[2], -tail[1]), parent)
        for bone, (head, tail, parent) in BODY.items()
    }
    other = skeleton("other", lying)
    person(other, "someone")
    take(other)
    for frame in FRAMES:
        x, y, z = joints(other, frame).T
        assert np.abs(np.stack((x, -z, y), axis=1) - joints(one, frame)).max() < 1e-4


def test_what_hangs_on_another_bone_is_refused_by_name():
    one = skeleton("one", roll=1.0)
    walk = moved(one, "one|walk")
    other = skeleton("other", BODY | {"foot.L": ((0.1, 0, 0.5), (0.1, 0, 0), "hips")})
    person(other, "someone")
    assert fit_of(other, walk).misfits == ("foot.L",)
    with pytest.raises(RuntimeError, match=r"one\|walk does not fit someone: .* foot.L are built"):
        take(other)
    assert "Made for another skeleton: one|walk." in told(bpy.context.scene)


def test_what_is_no_walk_is_never_taken_without_a_question():
    one = skeleton("one")
    for name in ("one|death", "one|idle"):
        keep(one, moved(one, name))
    other = skeleton("other", roll=1.0)
    person(other, "someone")
    with pytest.raises(RuntimeError, match=r"is called a walk \(one\|death, one\|idle\): choose"):
        take(other)
    assert "choose the action (one|death, one|idle) in Character Groups" in told(bpy.context.scene)
    assert other.animation_data is None
    bpy.ops.crowd_lod.take_action(group="someone", action="one|idle")
    assert other.animation_data.action.name == "one|idle other"
    bpy.ops.crowd_lod.populate()
    assert "glide" not in told(bpy.context.scene)


def test_who_was_given_an_action_is_not_who_it_was_made_for():
    one = skeleton("one")
    walk = moved(one, "walk")
    keep(one, walk)
    one.animation_data.action = None
    wrong = skeleton("wrong", roll=2.0)
    wrong.animation_data_create().action = walk
    other = skeleton("other", roll=2.0)
    assert fit_of(other, walk).source == one and fit_of(other, walk).turned
    assert fit_of(wrong, walk).source == one and fit_of(one, walk).source == one
    assert not fit_of(one, walk).turned


def test_an_action_that_a_state_names_is_judged_likewise():
    one = skeleton("one")
    moved(one, "wave")
    other = skeleton("other", roll=1.0)
    home = person(other, "someone")
    with pytest.raises(CrowdError, match=r"wave was made for one, and bones of someone rest"):
        performance_of("someone", list(home.objects), ["wave"])
    bpy.context.scene.crowd_lod.count = 2
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.take_action(group="someone", action="wave")
    turned = other.animation_data.action
    turned.name = "wave someone"
    (_, part) = performance_of("someone", list(home.objects), ["wave"]).parts
    assert part.action == turned
