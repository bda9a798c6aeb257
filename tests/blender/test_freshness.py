"""Whether anything is out of date has one answer: Next, messages and Update All say the same."""

import importlib.util
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.deliver.update_all import due_steps, update_all
from crowd_lod_extension.operators.freshness.artifacts import (
    CROWD,
    PROOF,
    ProofResult,
    current_proof,
    note_proof,
    proof_parts,
    reasons,
)
from crowd_lod_extension.operators.settings.messages import label_of
from crowd_lod_extension.operators.ui import steps

from ..support.characters import character, new, rig, skin, tube
from ..support.commands import run
from ..support.freshness import changed_since_build, changed_since_make, changed_since_populate
from ..support.objects import collection

pytestmark = pytest.mark.usefixtures("at_once", "rough_lods")

DOCS = Path(__file__).parents[2] / "docs"
FIRST = "crowd_lod.populate", "crowd_lod.make_levels", "crowd_lod.plan_shot", "crowd_lod.build"


@pytest.fixture
def shot(saved_once, request):
    """A bending tube by a rig that walks, planned and built."""

    def make():
        scene = request.getfixturevalue("small_shot")
        armature = rig("walker")
        scene.collection.objects.link(armature)
        body = new("body", tube("body", 12, 8))
        skin(body, armature)
        scene.crowd_lod.characters = character(body, armature)
        scene.crowd_lod.level_count = 2
        bpy.ops.crowd_lod.populate()
        bpy.ops.crowd_lod.make_levels()

    scene = saved_once("walker", make)
    finished(update_all(scene))  # a plan is a file of its own
    return scene


def rest(scene):
    """Take the rig's action away: a T-pose, which is meant."""
    bpy.data.objects["walker"].animation_data_clear()
    bpy.data.objects["walker"]["stands_still"] = True


def subdivide(scene):
    bpy.data.objects["body"].modifiers.new("Subdivide", "SUBSURF").levels = 1


def simplify(scene):
    scene.render.use_simplify = True
    scene.render.simplify_subdivision_render = 0


def widen(scene):
    bpy.data.objects["body"].data.vertices[0].co.x += 0.2


def add(scene):
    other = new("other", tube("other", 16, 12))
    collection("other", other, within=scene.crowd_lod.characters)


def ask_for_less(scene):
    scene.crowd_lod.budget_triangles = 10**7


# what is due first, and what messages name
EDITS = {
    rest: ("crowd_lod.populate", "the motion of walker"),
    add: ("crowd_lod.populate", "the character groups"),
    simplify: ("crowd_lod.make_levels", "Simplify (was off, now to 0 subdivisions)"),
    widen: ("crowd_lod.make_levels", "the character walker"),
    ask_for_less: ("crowd_lod.plan_shot", "the budget"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_next_messages_and_update_all_name_the_same(shot, edit):
    assert due_steps(shot) == {} and steps.next_operator(shot) == "crowd_lod.verify"
    edit(shot)
    shot.view_layers[0].update()
    operator, part = EDITS[edit]
    assert steps.next_operator(shot) == operator == next(iter(reasons(shot)))
    assert any(part in line.sentence for line in steps.messages(shot))
    label = label_of(operator)
    assert next(iter(due_steps(shot))) == label and part in due_steps(shot)[label]
    done = finished(update_all(shot))
    assert next(iter(done)) == label
    assert due_steps(shot) == {} and steps.next_operator(shot) == "crowd_lod.verify"


def test_an_update_says_which_groups_there_are_where_these_change(shot):
    add(shot)
    said = finished(update_all(shot))["Populate"]
    assert "The groups were walker: other, walker now." in said


def test_an_action_that_a_script_gives_is_measured_by_the_next_update(shot):
    action = bpy.data.objects["walker"].animation_data.action
    slot = bpy.data.objects["walker"].animation_data.action_slot
    rest(shot)
    finished(update_all(shot))
    (group,) = shot.crowd_lod.groups
    still = group.period
    player = bpy.data.objects["walker"].animation_data_create()
    player.action = action
    player.action_slot = slot
    shot.view_layers[0].update()
    assert changed_since_populate(shot) == ["the motion of walker"]
    assert "Populate" in finished(update_all(shot))
    (group,) = shot.crowd_lod.groups
    assert group.period != still


def test_lods_follow_what_simplify_makes_of_the_character(shot):
    subdivide(shot)
    finished(update_all(shot))
    (group,) = shot.crowd_lod.groups
    full = group.triangles[0]
    simplify(shot)
    assert changed_since_make(shot) == ["Simplify (was off, now to 0 subdivisions)"]
    finished(update_all(shot))
    (group,) = shot.crowd_lod.groups
    assert group.triangles[0] == full / 4 > group.triangles[1]


def test_a_proof_is_of_the_build_and_the_cameras_that_it_showed(shot):
    assert current_proof(shot) is None
    note_proof(shot, ProofResult("All alike.", True, proof_parts(shot)))
    assert ("All alike.", "CHECKMARK", "") in steps.messages(shot) and steps.next_operator(
        shot
    ) == ""
    shot.camera.data.lens = 20
    assert current_proof(shot) is None and "crowd_lod.verify" in reasons(shot)
    note_proof(shot, ProofResult("OK but for a hair.", False, proof_parts(shot)))
    assert ("OK but for a hair.", "ERROR", "") in steps.messages(shot)
    assert PROOF.operator in reasons(shot)


def test_before_the_first_populate_there_is_no_crowd(small_shot):
    character(new("Tube", tube("Tube", 16, 12)))
    assert reasons(small_shot)[CROWD.operator] == "there is no crowd"
    assert steps.next_operator(small_shot) == CROWD.operator


@pytest.mark.once
def test_what_the_command_builds_says_what_has_changed(shot, tmp_path):
    for more in ((), ("--bake",)):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
        out = tmp_path / f"out{len(more)}.blend"
        words = ["build", str(tmp_path / "shot.blend"), "--out", str(out), "--quiet", *more]
        assert run(*words) == 0
        bpy.ops.wm.open_mainfile(filepath=str(out))
        built = bpy.context.scene
        assert changed_since_build(built) == []
        built.crowd_lod.seed += 1
        assert changed_since_build(built) == ["the crowd"]


@pytest.mark.once
def test_the_page_of_artifacts_is_of_this_code():
    spec = importlib.util.spec_from_file_location("freshness", DOCS / "freshness.py")
    freshness = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(freshness)
    page = (DOCS / "notes" / "freshness.md").read_text(encoding="utf-8")
    assert page == freshness.page(), "run docs/freshness.py"
