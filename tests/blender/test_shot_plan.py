"""The stored shot plan: who shows it, when it does not hold, and what is said of wrong ones."""

import csv
import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.planned import LEVEL
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.blender.animation import curves_of
from crowd_lod_extension.operators.build import bake, frame_update, render_setup, shelves
from crowd_lod_extension.operators.deliver.preview.preview import preview, verdict_in
from crowd_lod_extension.operators.deliver.preview.preview_stage import Preview
from crowd_lod_extension.operators.plan import shot_survey
from crowd_lod_extension.operators.scene.plan_verdict import verdict_in_words
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.scene_frames import frame_now

pytestmark = pytest.mark.once  # the same on every Blender

FRAMES = range(1, 13)


@pytest.fixture
def zoomed(two_levels):
    return zoom(two_levels)


def zoom(scene):
    """A zoom towards the crowd: LODs must change."""
    lens = scene.camera.data
    for frame, lens.lens in ((1, 15), (12, 200)):
        lens.keyframe_insert("lens", frame=frame)
    scene.crowd_lod.choice = "BY_TOLERANCE"
    scene.crowd_lod.tolerance = 4.0
    scene.crowd_lod.pop_reduction = 0.5
    return scene


def planned(scene, folder):
    """Press Plan Shot; return the stored plan."""
    settings = scene.crowd_lod
    settings.frames = "1:12"
    settings.output_folder = str(folder.parent)
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    return plan_file.read(folder / "plan.npz")


def frame_at(scene, number, subframe=0.0):
    scene.frame_set(number, subframe=subframe)
    return frame_now(scene, bpy.context.evaluated_depsgraph_get())


def levels_of(frame):
    """{agent: LOD} of the frame's buckets."""
    return dict(zip(frame.buckets.order.tolist(), frame.buckets.levels.tolist(), strict=True))


def test_every_frame_shows_the_plan(zoomed, tmp_path):
    before = [levels_of(frame_at(zoomed, number)) for number in FRAMES]
    stored = planned(zoomed, tmp_path / "plan")
    differ = 0
    for f, number in enumerate(FRAMES):
        frame = frame_at(zoomed, number)
        row = stored.row(f, zoomed.crowd_lod.count) & LEVEL
        assert frame.planned and not frame.unplanned
        assert levels_of(frame) == {agent: row[agent] for agent in before[f]}  # who is seen stays
        assert all(row[agent] <= level for agent, level in before[f].items())
        differ += sum(row[agent] < level for agent, level in before[f].items())
    assert differ > 0


def test_build_and_bake_show_the_plan(zoomed, tmp_path):
    stored = planned(zoomed, tmp_path / "plan")
    finished(render_setup.build(read_crowd(zoomed)))
    zoomed.frame_set(6)
    frame_update.update(zoomed, bpy.context.evaluated_depsgraph_get())
    live = levels_of_points(zoomed, lambda ids, frames: ids)
    row = stored.row(5, zoomed.crowd_lod.count) & LEVEL
    assert live and all(row[agent] == level for agent, level in live.items())
    built = finished(bake.bake(zoomed, FRAMES))
    assert not any("shot plan" in note for note in built.notes)
    baked = levels_of_points(zoomed, lambda ids, frames: zip(frames, ids, strict=True))
    assert {frame for frame, _ in baked} == set(FRAMES)
    rows = {
        number: stored.row(f, zoomed.crowd_lod.count) & LEVEL for f, number in enumerate(FRAMES)
    }
    assert all(rows[frame][agent] == level for (frame, agent), level in baked.items())


def test_a_live_build_holds_what_its_plan_shows(zoomed, tmp_path):
    finished(render_setup.build(read_crowd(zoomed)))
    everything = len(meshes_in(zoomed))
    planned(zoomed, tmp_path / "plan")
    built = finished(render_setup.build(read_crowd(zoomed)))
    assert len(meshes_in(zoomed)) < everything / 2
    live = {number: instances_at(zoomed, number) for number in (1, 6, 12)}
    after = instances_at(zoomed, 30)  # beyond the plan
    lods = levels_of(frame_at(zoomed, 30))
    again = finished(render_setup.build(read_crowd(zoomed)))
    assert again.collections == [] != built.collections  # it stays
    finished(bake.bake(zoomed, FRAMES))
    assert all(live.values()) and live == {n: instances_at(zoomed, n) for n in live}
    # nobody is missing there, and nobody is coarser than it may be
    built = sorted(int(name.split("LOD ")[1].split()[0]) for name, _ in after)
    assert len(built) == len(lods) and all(
        level <= allowed for level, allowed in zip(built, sorted(lods.values()), strict=True)
    )


def meshes_in(scene):
    """The objects of the characters in the scene's build."""
    inside = scene.crowd_lod.build.children_recursive
    return {item for child in inside for item in child.objects if item.type == "MESH"}


def instances_at(scene, number):
    """[(object, its place in mm)] of the build's instances in a frame, sorted."""
    scene.frame_set(number)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    if render_setup.BAKED not in scene.crowd_lod.build:
        frame_update.update(scene, depsgraph)
        depsgraph = bpy.context.evaluated_depsgraph_get()
    return sorted(
        (each.object.name, tuple(round(1000 * x) for x in each.matrix_world.translation.xy))
        for each in depsgraph.object_instances
        if each.is_instance and "LOD" in each.object.name and each.object.type == "MESH"
    )


def levels_of_points(scene, keys):
    """{key: LOD} of the build's points that the camera sees."""
    found = {}
    for bucket, item in shelves.points_of(scene.crowd_lod.build).items():
        if bucket.kind == "LOD" and len(item.data.vertices):
            columns = [
                [each.value for each in item.data.attributes[key].data]
                if key in item.data.attributes
                else []
                for key in ("id", "frame")
            ]
            found |= dict.fromkeys(keys(*columns), bucket.level)
    return found


def test_between_frames_nobody_is_coarser_than_allowed(zoomed, tmp_path):
    planned(zoomed, tmp_path / "plan")
    frame = frame_at(zoomed, 5, 0.5)
    zoomed.crowd_lod.use_shot_plan = False
    allowed = levels_of(frame_at(zoomed, 5, 0.5))
    assert frame.planned and all(
        level <= allowed[agent] for agent, level in levels_of(frame).items()
    )


CHANGES = {
    "the camera": lambda scene: setattr(scene.camera, "delta_location", (0.5, 0, 0)),
    "the crowd": lambda scene: setattr(scene.crowd_lod, "seed", 99),
    "the choice of LODs": lambda scene: setattr(scene.crowd_lod, "tolerance", 2.0),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_plan_that_does_not_fit_is_not_used_and_says_why(zoomed, tmp_path, what):
    planned(zoomed, tmp_path / "plan")
    CHANGES[what](zoomed)
    frame = frame_at(zoomed, 6)
    assert not frame.planned
    assert (
        frame.unplanned
        == f"The shot plan is not used, for {what} changed since it was made: press Plan Shot "
        f"again."
    )
    zoomed.crowd_lod.use_shot_plan = False
    assert levels_of(frame) == levels_of(frame_at(zoomed, 6))


def test_outside_of_its_frames_thresholds_hold(zoomed, tmp_path):
    planned(zoomed, tmp_path / "plan")
    frame = frame_at(zoomed, 30)
    assert not frame.planned and "covers frames 1 to 12" in frame.unplanned


def rewritten(path, **changed):
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changed
    np.savez_compressed(
        path, **{name: value for name, value in arrays.items() if value is not None}
    )


WRONG = {
    "another version": (lambda path: rewritten(path, version=np.array(1)), "of another version"),
    "a missing array": (lambda path: rewritten(path, cameras=None), "lacks cameras"),
    "missing levels": (lambda path: rewritten(path, levels_6=None), "lacks levels_6"),
    "too few agents": (
        lambda path: rewritten(path, levels_6=np.zeros(3, np.uint8)),
        "does not have",
    ),
    "times that run backwards": (
        lambda path: rewritten(path, times=np.arange(12.0)[::-1]),
        "spoilt in times",
    ),
    "no zip file": (lambda path: path.write_bytes(b"PK\x03\x04 nothing"), "cannot be read"),
    "no file": (lambda path: path.unlink(), "There is no shot plan"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_spoilt_plan_is_said_in_a_sentence(zoomed, tmp_path, what):
    planned(zoomed, tmp_path / "plan")
    spoil, words = WRONG[what]
    spoil(tmp_path / "plan" / "plan.npz")
    frame = frame_at(zoomed, 6)
    assert not frame.planned and words in frame.unplanned and "\n" not in frame.unplanned


def test_a_cut_to_another_camera_hides_switches(zoomed):
    other = zoomed.camera.copy()
    other.data = zoomed.camera.data.copy()
    zoomed.collection.objects.link(other)
    for frame, camera in ((1, zoomed.camera), (7, other)):
        zoomed.timeline_markers.new(f"{frame}", frame=frame).camera = camera
    survey = finished(shot_survey.survey_of(read_crowd(zoomed), FRAMES)).survey
    assert survey.cuts.tolist() == [number == 7 for number in FRAMES]
    joined = [survey.joined(block) for block in survey.cells.blocks]
    assert not joined[0][6].any() and joined[0][7].any()


def test_settings_that_are_animated_are_refused(zoomed, tmp_path):
    settings = zoomed.crowd_lod
    for frame, settings.count in ((1, 40), (12, 60)):
        settings.crowds[0].keyframe_insert("count", frame=frame)
    settings.frames = "1:12"
    settings.output_folder = str(tmp_path)
    with pytest.raises(RuntimeError, match="The crowd's settings change at frame"):
        bpy.ops.crowd_lod.plan_shot()
    assert not settings.shot_plan and not (tmp_path / "plan").exists()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("frames", "12:1", "run backwards"), ("budget_triangles", 1, "too low")],
)
def test_bad_input_leaves_the_scene_as_it_was(zoomed, tmp_path, name, value, words):
    settings = zoomed.crowd_lod
    settings.frames = "1:12"
    settings.output_folder = str(tmp_path)
    setattr(settings, name, value)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.crowd_lod.plan_shot()
    assert not settings.shot_plan and not (tmp_path / "plan").exists()


def test_a_budget_holds_in_every_frame(levelled, tmp_path):
    zoomed = zoom(levelled)
    most = {}
    for zoomed.crowd_lod.tolerance in (1.0, 1e6):
        most[zoomed.crowd_lod.tolerance] = max(
            frame_at(zoomed, number).triangles for number in FRAMES
        )
    zoomed.crowd_lod.tolerance = 1.0
    budget = zoomed.crowd_lod.budget_triangles = int(0.5 * (most[1.0] + most[1e6]))
    assert budget < most[1.0]
    planned(zoomed, tmp_path / "plan")
    assert max(frame_at(zoomed, number).triangles for number in FRAMES) <= budget
    told = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert told["shot"]["tolerance_raised"] and told["shot"]["tolerance"] > 1


def test_the_largest_switches_are_gone_to_in_turn(zoomed, tmp_path):
    zoomed.crowd_lod.pop_reduction = 0.0
    planned(zoomed, tmp_path / "plan")
    with (tmp_path / "plan" / "switches.csv").open() as file:
        rows = sorted(csv.DictReader(file), key=lambda row: -float(row["change_px"]))
    assert len(rows) > 2
    for row in rows[:3]:
        assert bpy.ops.crowd_lod.go_to_switch() == {"FINISHED"}
        assert (zoomed.frame_current, zoomed.crowd_lod.agent) == (
            int(row["frame"]),
            int(row["agent"]),
        )
    (tmp_path / "plan" / "switches.csv").unlink()
    with pytest.raises(RuntimeError, match="press Plan Shot again"):
        bpy.ops.crowd_lod.go_to_switch()


def test_a_plan_that_is_switched_off_takes_distances_again(zoomed, tmp_path):
    planned(zoomed, tmp_path / "plan")
    zoomed.crowd_lod.use_shot_plan = False
    assert not frame_at(zoomed, 6).planned


def test_preview_plans_first(zoomed, tmp_path):
    wanted = Preview(frames=[1, 6, 12], folder=tmp_path / "preview", width=64)
    plan = finished(preview(zoomed, wanted, []))
    assert plan["version"] == 3 and plan["shot"]["frames"] == list(FRAMES)
    assert "shot plan" in (tmp_path / "preview" / "report.html").read_text()
    stored = plan_file.read(tmp_path / "preview" / "plan.npz")
    for row in plan["frames"]:
        levels = stored.row(row["frame"] - 1, zoomed.crowd_lod.count)
        seen = list(levels_of(frame_at(zoomed, row["frame"])))
        assert np.bincount(levels[seen], minlength=2).tolist() == [
            row[f"lod{k}"] for k in range(len(np.bincount(levels[seen], minlength=2)))
        ]
    settings = zoomed.crowd_lod
    assert not settings.shot_plan  # the user's own scene stays
    settings.shot_plan = str(tmp_path / "preview" / "plan.npz")
    again = Preview(frames=[6], folder=tmp_path / "again", width=64)
    assert verdict_in(plan) == verdict_in(finished(preview(zoomed, again, []))) != ""
    settings.seed += 1  # the plan is of another crowd
    assert verdict_in(finished(preview(zoomed, again, []))) == ""


def test_no_frames_is_an_error(zoomed):
    with pytest.raises(CrowdError, match="no frames"):
        finished(shot_survey.survey_of(read_crowd(zoomed), []))


def test_lods_of_other_settings_are_named(two_levels, tmp_path):
    settings = two_levels.crowd_lod
    settings.level_count = 3
    settings.frames = "1:3"
    settings.output_folder = str(tmp_path)
    with pytest.raises(RuntimeError, match="do not fit the settings"):
        bpy.ops.crowd_lod.plan_shot()
    assert not (tmp_path / "plan").exists()


def test_whom_the_far_clip_hides_at_once_is_in_the_verdict(two_levels, tmp_path):
    scene = two_levels
    lens = scene.camera.data
    frame_at(scene, 6)
    eye = np.array(scene.camera.matrix_world.translation)
    crowd = frame_at(scene, 6).crowd
    away = np.linalg.norm(np.column_stack([crowd.x, crowd.y, crowd.z]) - eye, axis=1)
    lens.clip_end = 1000.0
    in_view = set(levels_of(frame_at(scene, 6)))  # the others left at a side
    for number, lens.clip_end in ((1, 1000.0), (5, 1000.0), (6, float(np.median(away)))):
        lens.keyframe_insert("clip_end", frame=number)
    for curve in curves_of(lens.animation_data):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    seen = {number: set(levels_of(frame_at(scene, number))) for number in (5, 6)}
    gone = len(seen[5] & in_view - seen[6])
    assert gone > 1
    planned(scene, tmp_path / "plan")
    verdict = verdict_in_words(scene.crowd_lod)
    assert f"{gone} agents vanish at once at the far clip ({lens.clip_end:.3g} m)" in verdict
    assert "frame 6." in verdict
    assert verdict in (tmp_path / "plan" / "report.html").read_text(encoding="utf-8")
