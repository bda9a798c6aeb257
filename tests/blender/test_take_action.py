"""Characters whose rig plays nothing: told at Populate, and given an action whose bones are
theirs.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.scene.characters.action_choice import take_walks
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.scene.characters.take_action import CROWDLOD_OT_take_action
from crowd_lod_extension.operators.ui import steps

from ..support.characters import character, edited, new, rig, skin, tube
from ..support.freshness import changed_since_populate
from ..support.messages import told
from ..support.objects import placed


def bent(name):
    """A rig that bends from frame 1 to 10, as the motion's file of a pack brings it, and its
    action.
    """
    armature = rig(name)
    bpy.context.scene.collection.objects.link(armature)
    armature.animation_data.action.name = f"{name} walk"
    return armature, armature.animation_data.action


@pytest.fixture
def skinned():
    """A character in its bind pose, as the skin's file of a pack brings it."""
    armature, action = bent("skin")
    armature.animation_data_clear()
    bpy.data.actions.remove(action)
    item = new("body", tube("body", 8, 4))
    skin(item, armature)
    character(item)
    bpy.context.scene.crowd_lod.count = 2
    return armature


def rename(armature, prefix):
    for bone in armature.data.bones:
        bone.name = prefix + bone.name  # also in the curves that move it


def test_a_character_without_an_action_is_told_with_the_way_out(skinned):
    settings = bpy.context.scene.crowd_lod
    bpy.ops.crowd_lod.populate()
    assert "someone has no action, and would glide: import the file" in told(bpy.context.scene)
    bent("motion")
    bpy.ops.crowd_lod.populate()
    assert "press Take Action, which gives it motion walk" in told(bpy.context.scene)
    assert bpy.ops.crowd_lod.take_action() == {"FINISHED"}
    assert skinned.animation_data.action == bpy.data.actions["motion walk"]
    assert changed_since_populate(bpy.context.scene) == ["the motion of someone"]
    bpy.ops.crowd_lod.populate()
    assert "glide" not in told(bpy.context.scene)
    assert groups_of(settings)[0].period == pytest.approx(9 / 24)


@pytest.fixture
def renamed():
    """The button Take Action under another label."""
    operator = CROWDLOD_OT_take_action
    before = operator.bl_label
    for label in ("Learn to Walk", before):
        bpy.utils.unregister_class(operator)
        operator.bl_label = label
        bpy.utils.register_class(operator)
        if label != before:
            yield label


def test_a_warning_keeps_its_button_under_another_label(skinned, renamed):
    bpy.ops.crowd_lod.populate()
    (line,) = (line for line in steps.messages(bpy.context.scene) if line.remedy)
    assert f"then press {renamed}." in line.sentence and line.remedy == "crowd_lod.take_action"


def remedied():
    """What the sidebar tells that a button mends."""
    return [line.sentence for line in steps.messages(bpy.context.scene) if line.remedy]


@pytest.mark.parametrize("still", [True, False])
def test_an_answer_is_known_to_the_sidebar_at_once(skinned, still, capfd):
    bent("motion")
    bpy.ops.crowd_lod.populate()
    assert len(remedied()) == 1
    bpy.ops.crowd_lod.take_action(still=still)
    assert not remedied()
    said = "someone now stands still in" if still else "someone plays motion walk now:"
    assert said in capfd.readouterr().out


def test_two_who_would_glide_are_told_in_one_line(skinned, capfd):
    body = bpy.data.objects["body"]
    other = body.copy()
    other.modifiers[0].object = skinned.copy()
    bpy.context.scene.crowd_lod.characters.children.link(bpy.data.collections.new("other"))
    for item in (other, other.modifiers[0].object):
        bpy.data.collections["other"].objects.link(item)
    bpy.ops.crowd_lod.populate()
    (sentence,) = remedied()
    assert sentence.startswith("other, someone have no action, and would")
    bpy.ops.crowd_lod.take_action(still=True)
    assert "other, someone now stand still in" in capfd.readouterr().out and not remedied()


def top(armature, frame):
    bpy.context.scene.frame_set(frame)
    return np.array(
        armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[-1].tail
    )


def test_prefixes_of_names_are_ignored_and_the_action_applies(skinned):
    motion, action = bent("motion")
    rename(motion, "mixamorig:")
    assert bpy.ops.crowd_lod.take_action() == {"FINISHED"}
    assert skinned.animation_data.action.name == "motion walk skin"
    assert motion.animation_data.action == action
    for frame in (1, 6, 10):
        assert np.allclose(top(skinned, frame), top(motion, frame), atol=1e-6)
    assert not np.allclose(top(skinned, 1), top(skinned, 10), atol=0.1)


def test_what_places_the_other_rig_does_not_move_this_one(skinned):
    motion, _ = bent("motion")
    motion.scale = (0.01, 0.01, 0.01)
    motion.keyframe_insert("scale", frame=1)
    bpy.ops.crowd_lod.take_action()
    bpy.context.scene.frame_set(5)
    assert tuple(skinned.evaluated_get(bpy.context.evaluated_depsgraph_get()).scale) == (1, 1, 1)


@pytest.mark.parametrize("change", ["names", "parents", "nothing there"])
def test_what_does_not_fit_is_refused_in_a_sentence(skinned, change):
    if change == "names":
        motion, _ = bent("motion")
        motion.data.bones["lower"].name = "wheel"
        motion.data.bones["upper"].name = "axle"
    elif change == "parents":
        motion, _ = bent("motion")
        with edited(motion) as bones:
            bones["upper"].parent = None
            bones["upper"].roll += 0.5
    wanted = (
        "motion walk does not fit someone: it was made for motion, whose upper are built otherwise"
        if change == "parents"
        else "No action of the file moves the bones of someone"
    )
    with pytest.raises(RuntimeError, match=rf"{wanted}.* rig\.$"):
        bpy.ops.crowd_lod.take_action()
    assert skinned.animation_data is None or skinned.animation_data.action is None
    if change == "parents":
        for more in ("1 other action does not fit either.", "2 other actions do not fit either."):
            motion.animation_data.action.copy()
            with pytest.raises(RuntimeError, match=rf"to this rig\. {more}$"):
                bpy.ops.crowd_lod.take_action()


def test_who_sits_in_an_audience_does_not_glide(skinned):
    settings = bpy.context.scene.crowd_lod
    text = bpy.data.texts.new("sit")
    text.from_string(
        '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"sit": {"start": '
        '1, "on": {"*": {}}}}}'
    )
    settings.machine = text
    skinned.pose.bones["upper"].rotation_euler = (0, 0, 0)
    bpy.ops.crowd_lod.populate()
    assert "press Stand Still" in told(bpy.context.scene)
    skinned.pose.bones["upper"].rotation_euler = (1, 0, 0)  # seated by hand
    bpy.ops.crowd_lod.populate()
    assert "glide" not in told(bpy.context.scene)


def test_motion_that_came_as_empties_is_told_with_the_way_out(skinned):
    for bone in skinned.data.bones:
        empty = placed(bone.name)
        empty.keyframe_insert("rotation_quaternion", frame=1)
    with pytest.raises(RuntimeError, match="Empties called as the bones of someone play its"):
        bpy.ops.crowd_lod.take_action()


def stash(armature, name):
    """Give the rig another action of its file, as glTF's importer does: in a muted track."""
    action = armature.animation_data.action.copy()
    action.name = name
    track = armature.animation_data.nla_tracks.new()
    track.mute = True
    track.strips.new(name, 1, action)
    return action


def test_of_several_actions_of_a_file_the_walk_is_taken_and_that_is_said():
    armature, _ = bent("skin")
    item = new("body", tube("body", 8, 4))
    skin(item, armature)
    for name in ("agree", "walk back", "walk"):
        stash(armature, name)
    armature.animation_data.action = bpy.data.actions["agree"]
    settings = bpy.context.scene.crowd_lod
    settings.characters = character(item)
    settings.count = 2
    bpy.ops.crowd_lod.populate()
    assert (
        "walks by the action agree, and its file has walk (chosen by name): press Take Action."
        in told(bpy.context.scene)
    )
    assert bpy.ops.crowd_lod.take_action() == {"FINISHED"}
    assert armature.animation_data.action == bpy.data.actions["walk"]
    bpy.ops.crowd_lod.populate()
    assert "agree" not in told(bpy.context.scene)
    armature.animation_data.action = bpy.data.actions["agree"]
    scene = bpy.context.scene
    (sentence,) = take_walks(scene, "Witch", [item])
    assert sentence == "Witch now plays walk (chosen by name) instead of agree."
    armature.animation_data.action = bpy.data.actions["skin walk"].copy()
    armature.animation_data.action.name = "dance of its own"
    assert [*take_walks(scene, "Witch", [item])] == []


def test_without_a_name_the_action_is_taken_that_moves_forward_at_a_persons_speed():
    armature, _ = bent("skin")
    item = new("body", tube("body", 8, 4))
    skin(item, armature)
    root = armature.pose.bones[0]
    gaits = ("gallop", 4.0, 0), ("fall", 1.2, 0.8), ("march", 1.1, 0.17)
    gaits += ("saunter", 0.6, 0), ("jog", 2.0, 0)
    for name, way, drop in (*gaits, ("nod", 0.0, 0)):
        action = stash(armature, name)
        armature.animation_data.action = action
        for frame, x in ((1, 0.0), (25, way)):  # a second
            root.location = (x, -drop * (frame > 1), 0)
            root.keyframe_insert("location", frame=frame)
    settings = bpy.context.scene.crowd_lod
    settings.characters = character(item)
    settings.count = 2
    bpy.ops.crowd_lod.populate()
    walk = "walks by the action nod, and its file has march (chosen by its speed): press"
    assert walk in told(bpy.context.scene) and not changed_since_populate(bpy.context.scene)
    (sentence,) = take_walks(bpy.context.scene, "Witch", [armature, item])
    assert armature.animation_data.action.name == "march"
    assert sentence == "Witch now plays march (chosen by its speed) instead of nod."
    assert [*take_walks(bpy.context.scene, "Witch", [armature, item])] == []
    armature.animation_data.action = bpy.data.actions["nod"]
    for name in ("march", "saunter", "jog"):
        bpy.data.actions.remove(bpy.data.actions[name])
    (sentence,) = take_walks(bpy.context.scene, "Witch", [armature, item])
    assert sentence == (
        "Witch plays nod, and no action of its file is called a walk: press Populate, and choose the "
        "one to walk by in Character Groups."
    )


def test_images_that_did_not_come_along_are_told_with_the_way_out(skinned, tmp_path):
    image = bpy.data.images.new("colormap", 2, 2)
    image.filepath_raw = str(tmp_path / "colormap.png")
    image.file_format = "PNG"
    image.save()
    image.source = "FILE"
    shirt = bpy.data.materials.new("shirt")
    tree = switch_nodes_on(shirt)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.data.objects["body"].data.materials.append(shirt)
    image.filepath = str(tmp_path / "Textures" / "colormap.png")
    image.reload()
    bpy.ops.crowd_lod.populate()
    assert "1 image of someone is missing, and renders pink (" in told(bpy.context.scene)
    assert "Textures/colormap.png): copy the pack's textures there, or use File" in told(
        bpy.context.scene
    )
    image.filepath = str(tmp_path / "colormap.png")
    image.reload()
    bpy.ops.crowd_lod.populate()
    assert "missing" not in told(bpy.context.scene)
