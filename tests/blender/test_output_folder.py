"""One folder of output for each file: where it is, and what moves when the file is saved."""

import json
import os
from pathlib import Path

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender.output_folders import full_path, output_folder
from crowd_lod_extension.operators.deliver.open_report import report_path
from crowd_lod_extension.operators.scene.plan_verdict import verdict_in_words

from ..support.characters import character, new
from ..support.freshness import changed_since_build
from ..support.objects import mesh_of, placed
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.once  # the same on every Blender


def small(scene):
    """Few agents, one LOD, one frame of few pixels."""
    settings = scene.crowd_lod
    settings.count = 20
    settings.level_count = 1
    settings.frames = "1"
    settings.width = 32
    settings.verify_count = 1
    return settings


def plan(scene):
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    return full_path(scene.crowd_lod.shot_plan)


def save(path, **options):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)
    return bpy.context.scene


def planned(scene):
    scene.frame_set(1)
    return frame_now(scene, bpy.context.evaluated_depsgraph_get()).planned


def test_output_of_an_unsaved_file_waits_in_the_session_and_moves_with_the_first_save(
    scene, tmp_path, capfd
):
    settings = small(scene)
    for name in ("plan_shot", "export_usd"):
        assert getattr(bpy.ops.crowd_lod, name)() == {"FINISHED"}
        assert ", until Blender ends: save the file " in capfd.readouterr().out
    before = output_folder(scene, "plan")
    assert before.is_relative_to(bpy.app.tempdir) and report_path(scene, "PLAN").is_file()
    scene = save(tmp_path / "people.blend")
    home = tmp_path / "people_crowd_lod"
    assert (
        not before.exists()
        and output_folder(scene, "plan") == home / "plan"
        and full_path(settings.shot_plan) == home / "plan" / "plan.npz"
    )
    assert report_path(scene, "PLAN").is_file() and (home / "usd" / "crowd.usdc").is_file()
    assert planned(scene)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "people.blend"))
    assert bpy.context.scene.crowd_lod.shot_plan == "//people_crowd_lod/plan/plan.npz" and planned(
        bpy.context.scene
    )


def test_files_in_one_folder_have_a_plan_each(scene, tmp_path):
    small(scene)
    save(tmp_path / "a.blend")
    first = plan(scene)
    save(tmp_path / "a.blend")
    scene = save(tmp_path / "b.blend")
    assert full_path(scene.crowd_lod.shot_plan) == first and planned(
        scene
    )  # until it has one of its own
    scene.crowd_lod.seed += 1
    second = plan(scene)
    save(tmp_path / "b.blend")
    assert (first.parts[-3], second.parts[-3]) == ("a_crowd_lod", "b_crowd_lod")
    for name in ("a", "b"):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / f"{name}.blend"))
        assert planned(bpy.context.scene)


@pytest.mark.parametrize("copy", (True, False), ids=("copy", "save as"))
def test_a_file_saved_elsewhere_names_the_plan_that_is_there(scene, tmp_path, copy):
    small(scene)
    path = plan(save(tmp_path / "a.blend"))
    before = scene.crowd_lod.shot_plan
    (tmp_path / "other").mkdir()
    save(tmp_path / "other" / "b.blend", copy=copy)
    assert scene.crowd_lod.shot_plan == (before if copy else "//../a_crowd_lod/plan/plan.npz")
    assert full_path(scene.crowd_lod.shot_plan).resolve() == path
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "b.blend"))
    assert full_path(bpy.context.scene.crowd_lod.shot_plan).resolve() == path and planned(
        bpy.context.scene
    )


def test_a_copy_of_an_unsaved_file_has_a_copy_of_the_plan(scene, tmp_path):
    small(scene)
    path = plan(scene)
    before = scene.crowd_lod.shot_plan
    save(tmp_path / "a.blend", copy=True)
    assert path.is_file() and scene.crowd_lod.shot_plan == before and planned(scene)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert planned(bpy.context.scene)


def test_the_verdict_follows_the_plan_whoever_made_it(scene, tmp_path):
    path = plan(small(scene).id_data)
    settings = scene.crowd_lod
    verdict = settings.shot_verdict
    assert verdict and settings.shot_budgets
    place = settings.shot_plan
    settings.shot_plan = ""
    assert (settings.shot_verdict, settings.shot_budgets) == ("", "")
    settings.shot_plan = place
    assert settings.shot_verdict == verdict
    scene = save(tmp_path / "a.blend")
    assert scene.crowd_lod.shot_verdict == verdict  # its path was rewritten meanwhile
    about = full_path(scene.crowd_lod.shot_plan).with_name("plan.json")
    assert about != path.with_name("plan.json")
    plan_json = json.loads(about.read_text(encoding="utf-8"))
    plan_json["shot"]["verdict"]["change"] = {"pixels": 9.5, "frame": 7, "agent": 1}
    about.write_text(json.dumps(plan_json))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    said = verdict_in_words(bpy.context.scene.crowd_lod)
    assert said.startswith("Largest visible pop: 9.5 px at frame 7.")


def test_a_save_that_fails_leaves_settings_and_output(scene, tmp_path):
    small(scene)
    path = plan(scene)
    before = scene.crowd_lod.shot_plan
    with pytest.raises(RuntimeError):
        save(tmp_path / "nowhere" / "a.blend")
    assert path.is_file() and scene.crowd_lod.shot_plan == before and planned(scene)


def test_a_new_file_does_not_take_the_output_of_the_one_before(scene, tmp_path):
    small(scene)
    path = plan(scene)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert output_folder(bpy.context.scene, "plan") != path.parent
    save(tmp_path / "new.blend")
    assert [path.name for path in tmp_path.iterdir()] == ["new.blend"]


def test_scenes_of_a_file_have_a_folder_each(scene, tmp_path):
    small(scene)
    save(tmp_path / "a.blend")
    assert output_folder(scene, "plan") == tmp_path / "a_crowd_lod" / "plan"
    other = scene.copy()
    folders = [output_folder(each, "plan") for each in (scene, other)]
    assert folders == [
        tmp_path / "a_crowd_lod" / each.name.replace(".", "_") / "plan" for each in (scene, other)
    ]


@pytest.mark.parametrize(
    "text, name",
    [("//out", "out"), ("//{blend_name}", "untitled"), ("//../up/x", "__/up/x"), ("//", ".")],
)
def test_paths_of_an_unsaved_file_stay_in_the_folder_of_the_session(text, name):
    home = full_path(text)
    assert home.is_relative_to(bpy.app.tempdir) and home.relative_to(full_path("//")) == Path(name)


def test_a_path_beside_a_saved_file_or_from_the_root_is_that_path(tmp_path):
    assert full_path(str(tmp_path)) == tmp_path and full_path("out") == Path.cwd() / "out"
    save(tmp_path / "a.blend")
    assert (
        full_path("//out") == tmp_path / "out"
        and full_path("//{blend_name}/x") == tmp_path / "a" / "x"
    )


@pytest.mark.parametrize(
    "name, value, words",
    [("output_folder", " ", "Output Folder is empty"), ("usd_file", "a/b.usdc", "a name")],
)
def test_a_wrong_setting_is_said(scene, name, value, words):
    setattr(small(scene), name, value)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.crowd_lod.export_usd()


def test_a_record_of_points_moves_along(tmp_path):
    scene = bpy.context.scene
    settings = scene.crowd_lod
    item = placed("Points", mesh_of("Points", [(0, 0, 0), (1, 0, 0)]))
    character(new("Body", mesh_of("Body", [(0, 0, 0), (0, 0, 1), (0, 1, 0)], [(0, 1, 2)])))
    settings.source = "POINTS"
    settings.points = item
    scene.frame_end = 3
    assert bpy.ops.crowd_lod.record_points() == {"FINISHED"}
    assert full_path(settings.tracks_file).is_file()
    save(tmp_path / "a.blend")
    assert settings.tracks_file == "//a_Points.npz"
    with np.load(tmp_path / "a_Points.npz") as file:
        assert file.files


def test_a_plan_that_is_copied_or_made_again_alike_leaves_the_build_as_it_is(
    scene, tmp_path, at_once
):
    settings = small(scene)
    save(tmp_path / "people.blend")
    path = plan(scene)
    bpy.ops.crowd_lod.build()
    os.utime(path, (1, 1))
    assert changed_since_build(scene) == []
    plan(scene)
    assert changed_since_build(scene) == []
    settings.frames = "1:2"
    plan(scene)
    assert "the shot plan" in changed_since_build(scene)
