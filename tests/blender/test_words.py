"""What the sidebar says agrees with the button that it draws as the next one, and with the
scene.
"""

import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.machine_edits import add_state
from crowd_lod_extension.crowd_lod.crowd.state_machine import preset_text
from crowd_lod_extension.operators.blender import steps as work
from crowd_lod_extension.operators.deliver.usd.openusd import MISSING, openusd
from crowd_lod_extension.operators.scene.machine.machine_editor import change, draft_of, problem_of
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.ui import steps


def plane(name):
    """A square of 100 m, as an object of the scene."""
    bpy.ops.mesh.primitive_plane_add(size=100)
    bpy.context.object.name = name
    return bpy.context.object


@pytest.mark.parametrize("setting", ("terrain_object", "spawn_object"))
def test_who_is_told_to_populate_finds_that_button_next(levelled, setting):
    settings = levelled.crowd_lod
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert steps.next_operator(levelled) != "crowd_lod.populate"
    if setting == "spawn_object":
        settings.spawn_on = "SURFACE"
    setattr(settings, setting, plane("Ground"))
    asking = [
        sentence
        for sentence, *_ in steps.messages(levelled)
        if "Changed since Populate" in sentence
    ]
    assert len(asking) == 1 and steps.next_operator(levelled) == "crowd_lod.populate"
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert steps.next_operator(levelled) != "crowd_lod.populate"
    assert not any(
        "Changed since Populate" in sentence for sentence, *_ in steps.messages(levelled)
    )


def test_a_character_of_another_name_asks_for_populate_and_then_for_its_lods(levelled):
    settings = levelled.crowd_lod
    settings.characters.children[0].name = "renamed"
    assert steps.next_operator(levelled) == "crowd_lod.populate"
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert steps.next_operator(levelled) == "crowd_lod.make_levels"
    assert any("renamed)" in sentence for sentence, *_ in steps.messages(levelled))
    assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}
    assert steps.next_operator(levelled) == "crowd_lod.plan_shot"


def test_the_sidebar_keeps_its_answers_while_a_step_is_at_work(levelled, monkeypatch):
    answers = steps.next_operator(levelled), steps.messages(levelled)
    with monkeypatch.context() as context:
        context.setattr(work, "_at_work", ["a step"])
        levelled.crowd_lod.characters.children[0].name = "renamed"
        levelled.crowd_lod.ratios[1] = 0.2
        assert answers == (steps.next_operator(levelled), steps.messages(levelled))
    assert steps.next_operator(levelled) == "crowd_lod.populate" != answers[0]
    assert steps.messages(levelled) != answers[1]


def places(scene):
    crowd = trajectory_of(scene).at(30)
    return np.stack([crowd.x, crowd.y])


def test_an_empty_text_is_as_no_state_machine_and_edits_begin_with_it(scene):
    bpy.ops.crowd_lod.populate()
    before = places(scene)
    text = scene.crowd_lod.machine = bpy.data.texts.new("Text")
    np.testing.assert_array_equal(places(scene), before)
    assert draft_of(scene).states and not problem_of(scene) and not text.as_string()
    change(scene, add_state("wait"))
    assert "wait" in draft_of(scene).states
    assert len(text.as_string()) > len(preset_text("chapter"))


def test_without_openusd_the_button_says_why(scene):
    try:
        openusd()
    except Exception:
        assert not bpy.ops.crowd_lod.export_usd.poll()
        return
    assert bpy.ops.crowd_lod.export_usd.poll()
    modules = {
        name: module for name, module in sys.modules.items() if name.partition(".")[0] == "pxr"
    }
    try:
        sys.modules["pxr"] = None  # what an import of a module that is missing finds
        assert not bpy.ops.crowd_lod.export_usd.poll()
        with pytest.raises(RuntimeError, match="poll"):
            bpy.ops.crowd_lod.export_usd()
    finally:
        sys.modules.update(modules)
    assert "usd-core" in MISSING
