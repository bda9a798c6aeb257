"""What the overlay shows is never old: characters that are gone, an edit of the state machine."""

import bpy
import pytest
from crowd_lod_extension.operators.blender import sidebar_answers

from ..support.overlays import populated, shown

TOLD = "Changed since Populate: the character groups ({})"


@pytest.fixture
def scene(monkeypatch):
    monkeypatch.setattr(sidebar_answers, "LOOK", 0.0)
    with populated(50, one=2.0, two=1.0) as scene:
        scene.crowd_lod.overlay_mode = "POINTS"
        yield scene


def test_a_group_that_is_gone_is_named_until_the_crowd_is_populated_again(scene):
    assert shown(scene).notes == ()
    bpy.data.objects.remove(scene.crowd_lod.characters.objects["two"])
    assert shown(scene).notes == (TOLD.format("removed two"),)
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        bpy.ops.crowd_lod.populate()
    assert shown(scene).notes == ()


def test_populate_is_named_before_lod_meshes(scene):
    scene.crowd_lod.overlay_mode = "MESHES"
    assert "Press Make LOD Meshes" in shown(scene).notes[0]
    scene.crowd_lod.characters.objects["two"].name = "three"
    assert shown(scene).notes == (TOLD.format("added three, removed two"),)


def test_an_edit_of_the_state_machine_shows_in_the_next_drawing(scene):
    settings = scene.crowd_lod
    with bpy.context.temp_override(scene=scene):
        bpy.ops.crowd_lod.machine_preset(name="chapter")
    before = shown(scene).frame.trajectory.machine
    settings.machine.from_string(before.text.replace('"walk', '"go'))
    after = shown(scene).frame.trajectory.machine
    assert before.states != after.states and all(state.startswith("go") for state in after.states)
