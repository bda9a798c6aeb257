"""What the overlay shows is never old: settings that Blender tells nobody of, texts, and characters that are gone."""

import bpy
import pytest
from crowd_lod_extension.operators.overlay import redraw
from crowd_lod_extension.operators.overlay.appearance import missing_groups

from ..support.overlays import populated, shown


@pytest.fixture
def scene():
    with populated(50, one=2.0, two=1.0) as scene:
        scene.crowd_lod.overlay_mode = "POINTS"
        yield scene


def test_every_setting_counts_also_those_of_groups_and_texts(scene):
    settings = scene.crowd_lod
    settings.machine = text = bpy.data.texts.new("machine")
    assert not redraw.changed(scene)  # asked for the first time
    for change in (
        lambda: setattr(settings, "count", 60),
        lambda: setattr(settings, "agent", 3),
        lambda: settings.thresholds.__setitem__(1, 0.5),
        lambda: setattr(settings, "overlay_color", "STATE"),
        lambda: setattr(settings.groups[1], "own_thresholds", True),
        lambda: settings.groups[1].thresholds.__setitem__(0, 0.3),
        lambda: settings.exceptions.add(),
        lambda: setattr(settings, "characters", None),
        lambda: text.write("{"),
    ):
        assert not redraw.changed(scene)
        change()
        assert redraw.changed(scene) and not redraw.changed(scene)
    settings.groups[0].center = float("nan")
    assert redraw.changed(scene) and not redraw.changed(scene)
    bpy.data.texts.remove(text)


def test_a_group_that_is_gone_is_named_until_the_crowd_is_populated_again(scene):
    assert missing_groups(scene.crowd_lod) == shown(scene).notes == ()
    bpy.data.objects.remove(scene.crowd_lod.characters.objects["two"])
    assert shown(scene).notes == missing_groups(scene.crowd_lod)
    assert shown(scene).notes == ("No longer among the characters: two. Press Populate in the Crowd panel.",)
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        bpy.ops.crowd_lod.populate()
    assert shown(scene).notes == ()


def test_an_edit_of_the_state_machine_shows_in_the_next_drawing(scene):
    settings = scene.crowd_lod
    with bpy.context.temp_override(scene=scene):
        bpy.ops.crowd_lod.machine_preset(name="chapter")
    before = shown(scene).frame.trajectory.machine
    settings.machine.from_string(before.text.replace('"walk', '"go'))
    after = shown(scene).frame.trajectory.machine
    assert before.states != after.states and all(state.startswith("go") for state in after.states)
