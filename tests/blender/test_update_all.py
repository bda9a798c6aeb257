"""Update All does the steps that are due, in their order, and no other."""

import json
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.deliver.update_all import (
    due_steps,
    look_again,
    update_all,
    update_sentence,
)
from crowd_lod_extension.operators.ui import steps

from ..support.characters import character, new, rig, skin, tube
from ..support.commands import quietly, run

MAKE = "Make LOD Meshes"
PLAN = "Plan Shot"


@pytest.fixture
def shot(small_shot):
    """Six tubes, seen in two frames by a camera on a path."""
    scene = small_shot
    scene.crowd_lod.characters = character(new("Tube", tube("Tube", 16, 12)))
    scene.crowd_lod.level_count = 2
    for frame in (1, 2):
        scene.camera.location.x = frame
        scene.camera.keyframe_insert("location", frame=frame)
        scene.camera.data.lens = 50 + frame
        scene.camera.data.keyframe_insert("lens", frame=frame)
    bpy.ops.crowd_lod.populate()
    return scene


def update(scene):
    """Update all; the labels of the steps that were done, those of which the sidebar knew."""
    look_again(scene)
    due = due_steps(scene)
    done = finished(update_all(scene))
    assert due_steps(scene) == {}  # no press is offered that would make nothing
    return [*done], [*due]


def change_path(scene):
    scene.camera.location.x = 9
    scene.camera.keyframe_insert("location", frame=2)
    scene.frame_set(1)  # where the camera is as it was


def change_ratios(scene):
    scene.crowd_lod.ratios[1] = 0.2


def set_budget(scene):
    scene.crowd_lod.budget_triangles = 10**7


def change_tilt(scene):
    scene.crowd_lod.tilt = not scene.crowd_lod.tilt


CHANGES = [
    (change_path, [PLAN]),
    (change_ratios, [MAKE, PLAN]),
    (set_budget, [PLAN]),
    (change_tilt, []),
]


def test_a_press_does_what_a_change_asks_for_and_the_next_nothing(shot):
    assert update(shot) == ([MAKE, PLAN, "Build"], [MAKE, PLAN, "Build"])
    shot.frame_set(2)
    assert update(shot) == ([], [])
    for change, expected in CHANGES:
        change(shot)
        shot.view_layers[0].update()
        done, due = update(shot)
        assert [label for label in done if label != "Build"] == expected, change
        assert set(due) <= set(done) and due, change
    assert update(shot) == ([], [])


def test_a_bake_follows_the_camera_path_also_where_the_frame_is_as_it_was(shot):
    finished(update_all(shot, bakes=True))
    assert update(shot) == ([], [])
    change_path(shot)
    shot.view_layers[0].update()
    assert update(shot) == ([PLAN, "Bake"], [PLAN, "Bake"])


def test_a_cancel_between_steps_leaves_those_that_are_done(shot):
    noted = []
    steps = update_all(shot, noted.append)
    while not noted:
        next(steps)
    next(steps)
    steps.close()
    assert noted == [MAKE]
    assert shot.crowd_lod.levels is not None and shot.crowd_lod.build is None
    assert update(shot) == ([PLAN, "Build"], [PLAN, "Build"])


def test_a_step_that_fails_is_named_with_those_that_stay(shot):
    shot.crowd_lod.budget_triangles = 1
    with pytest.raises(CrowdError, match=r"^Plan Shot: .*too low.* Make LOD Meshes before it"):
        finished(update_all(shot))
    assert shot.crowd_lod.levels is not None and not shot.crowd_lod.shot_plan


def test_what_the_steps_own_buttons_did_is_not_offered_again(shot):
    for button in ("make_levels", "plan_shot", "build"):
        getattr(bpy.ops.crowd_lod, button)()
    look_again(shot)
    assert due_steps(shot) == {}
    change_path(shot)
    look_again(shot)
    assert PLAN in due_steps(shot)


def test_a_build_by_distance_is_not_planned(shot):
    bpy.ops.crowd_lod.build()
    assert update(shot) == ([], [])
    change_tilt(shot)
    assert update(shot) == (["Build"], ["Build"])
    assert update_sentence(shot, {}).startswith(
        "Up to date: Populate, Make LOD Meshes, Plan Shot, Build"
    )


def test_the_command_updates_a_file_and_leaves_one_that_is_up_to_date(shot, tmp_path, capfd):
    path = Path(tmp_path, "shot.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    words = ["update", str(path), "--quiet", "--json"]
    assert run(*words) == 0
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert [*result["done"]] == [MAKE, PLAN, "Build"]
    saved = path.read_bytes()
    assert run(*words) == 0
    again = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert again["done"] == {} and "visible" in again["verdict"]
    assert again["verdict"] in again["summary"]
    assert path.read_bytes() == saved
    assert quietly("update", "plaza") == 1
    assert "write one by the command sample" in capfd.readouterr().err


@pytest.fixture
def newcomer(shot):
    """Beside the tubes a character with a rig that plays nothing, added after Populate."""
    finished(update_all(shot))
    armature = rig("Newcomer")
    armature.animation_data_clear()
    shot.collection.objects.link(armature)
    item = new("Newcomer body", tube("Newcomer body", 16, 12))
    skin(item, armature)
    character(item, name="Newcomer")
    return shot


@pytest.mark.once
def test_update_all_asks_before_it_makes_lods_of_a_character_without_an_action(newcomer):
    look_again(newcomer)
    assert "the character groups" in due_steps(newcomer)["Populate"]
    with pytest.raises(RuntimeError, match="Newcomer has no action: choose one in"):
        bpy.ops.crowd_lod.update_all()
    assert [group.name for group in newcomer.crowd_lod.groups] == ["Newcomer", "someone"]
    assert MAKE in due_steps(newcomer)
    first, *_ = steps.messages(newcomer)
    assert "Newcomer has no action" in first.sentence
    assert first.remedy == "crowd_lod.take_action"
    assert bpy.ops.crowd_lod.take_action(still=True) == {"FINISHED"}
    assert not any("has no action" in line.sentence for line in steps.messages(newcomer))
    assert bpy.data.collections["Newcomer"]["stands_still"]
    done, _ = update(newcomer)
    assert MAKE in done


@pytest.mark.once
def test_an_action_is_an_answer_too_and_scripts_can_give_either(newcomer):
    bpy.data.collections["Newcomer"]["stands_still"] = True
    assert MAKE in update(newcomer)[0]
    del bpy.data.collections["Newcomer"]["stands_still"]
    with pytest.raises(CrowdError, match="no action: choose"):
        finished(update_all(newcomer))
    bpy.ops.crowd_lod.take_action(group="Newcomer", action="NewcomerAction")
    assert update(newcomer)[0][:2] == ["Populate", MAKE]
