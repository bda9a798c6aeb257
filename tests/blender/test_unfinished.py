"""What an undo step, or a file, holds of a step that was at work: it is removed."""

import bpy
import pytest
from crowd_lod_extension.operators.blender import cleanup, frame_stepping, unfinished


@pytest.fixture
def noted(scene):
    """A scene for which a step has made an object and a mesh so far; the user made a world."""
    before = unfinished.state()
    bpy.data.objects.new("half", bpy.data.meshes.new("half mesh"))
    unfinished.note(scene, before)
    bpy.data.worlds.new("the user's")
    unfinished.note(scene, unfinished.state())
    yield scene
    unfinished.end(scene)


def test_what_a_step_has_made_is_removed_and_what_the_user_made_stays(noted):
    unfinished.clear()
    assert "half" not in bpy.data.objects and "half mesh" not in bpy.data.meshes
    assert "the user's" in bpy.data.worlds and unfinished.UNFINISHED not in noted


def test_nothing_is_removed_when_the_step_has_ended(noted):
    unfinished.end(noted)
    unfinished.clear()
    assert "half" in bpy.data.objects


def test_what_the_user_makes_while_a_step_runs_is_not_removed_with_what_the_step_has_made(scene):
    with cleanup.scratch():
        state = unfinished.state()
        bpy.data.worlds.new("the user's")
        unfinished.note_users(state)
        bpy.data.worlds.new("the step's")
    unfinished.end(scene)
    assert "the user's" in bpy.data.worlds and "the step's" not in bpy.data.worlds


def test_a_part_that_is_finished_stays_and_what_comes_after_it_goes(noted):
    before = unfinished.state()
    unfinished.keep(noted)
    bpy.data.objects.new("next half", None)
    unfinished.note(noted, before)
    unfinished.clear()
    assert "half" in bpy.data.objects and "next half" not in bpy.data.objects


def test_what_a_step_has_set_for_a_while_is_put_back(noted):
    with unfinished.put_back("scenes", noted, "crowd_lod", {"count": 7}):
        noted.crowd_lod.count = 8
        unfinished.note(noted, unfinished.state())
        unfinished.clear()
        assert noted.crowd_lod.count == 7


def test_the_frame_that_the_user_went_to_meanwhile_stays(scene):
    scene.frame_set(3)
    with frame_stepping.step_frames(scene) as at:
        at((), 10)
        scene.frame_set(33)
        at((), 11)
        assert scene.frame_current == 11
    assert scene.frame_current == 33
    with frame_stepping.step_frames(scene) as at:
        at((), 10)
        scene.frame_set(44)
    assert scene.frame_current == 44
    with frame_stepping.step_frames(scene) as at:
        at((), 10)
    assert scene.frame_current == 44
