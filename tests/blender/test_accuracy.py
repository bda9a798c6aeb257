"""Error against run time of a small scene: measured renders, the page, the button."""

import csv
import json
import os
import sys
from html import escape

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.machine import run_process
from crowd_lod_extension.operators.deliver.accuracy import ways
from crowd_lod_extension.operators.deliver.accuracy.accuracy import measure
from crowd_lod_extension.operators.deliver.accuracy.renders import choose_engine
from crowd_lod_extension.operators.deliver.accuracy.ways import (
    QUICK,
    THOROUGH,
    RenderWay,
    set_way,
    ways_of,
)
from crowd_lod_extension.operators.deliver.proof.verify import prepare_crowd
from crowd_lod_extension.operators.scene.scene_crowd import policy_of

from ..support.commands import quietly, run


@pytest.fixture
def tolerant(levelled):
    levelled.crowd_lod.choice = "BY_TOLERANCE"
    levelled.crowd_lod.tolerance = 2.0
    levelled.cycles.samples = 1
    return levelled


def test_ways_are_those_of_the_scene(tolerant):
    settings = tolerant.crowd_lod
    titles = [way.title for way in ways_of(settings, THOROUGH)]
    assert titles == [
        "without the crowd", "full detail", "full detail, culled", "by distance, at thirds",
        *(f"{each:g} px" for each in THOROUGH.tolerances), "2 px, with a shot plan",
    ]  # fmt: skip
    assert [way.tolerance for way in ways_of(settings, THOROUGH) if way.is_default] == [2.0]
    settings.tolerance = 3.0
    quick = ways_of(settings, QUICK)
    assert [way.tolerance for way in quick if way.kind == ways.TOLERANCE] == [3.0, 4.0]
    settings.choice = "BY_DISTANCE"
    assert [way.title for way in ways_of(settings, QUICK) if way.is_default] == [
        "by distance, as set"
    ]


def test_the_default_is_the_plan_of_a_scene_that_follows_one(tolerant):
    settings = tolerant.crowd_lod
    settings.shot_plan = "//plan.npz"
    settings.use_shot_plan = True
    for choice, title in zip(
        ("BY_TOLERANCE", "BY_DISTANCE"), ("2 px, with a shot plan", ways.PLANNED), strict=True
    ):
        settings.choice = choice
        assert [way.title for way in ways_of(settings, QUICK) if way.is_default] == [title]
    settings.choice = "BY_TOLERANCE"
    settings.memory_tolerance = 5.0
    set_way(settings, RenderWay(ways.TOLERANCE, 5.0))
    assert settings.memory_tolerance == 5.0 and not settings.use_shot_plan


def test_lods_that_are_left_from_before_are_no_way(tolerant):
    settings = tolerant.crowd_lod
    settings.choice = "BY_DISTANCE"
    settings.level_count = 1
    list(prepare_crowd(tolerant))
    titles = [way.title for way in ways_of(settings, QUICK)]
    assert len(settings.levels.children) > 1 and titles[3:] == ["by distance, as set"]


def test_a_way_sets_the_scene_so(tolerant):
    settings = tolerant.crowd_lod
    settings.memory_tolerance = 5.0
    set_way(settings, RenderWay(ways.TOLERANCE, 0.5))
    assert policy_of(settings).tolerance == 0.5
    set_way(settings, RenderWay(ways.CULLED))
    assert policy_of(settings).count == 1
    settings.groups[0].use_custom_thresholds = True
    set_way(settings, RenderWay(ways.DISTANCE))
    policy = policy_of(settings)
    assert policy.count == len(settings.levels.children) and not policy.group_thresholds


@pytest.mark.parametrize(
    ("count", "thirds"),
    [(2, [1 / 3]), (3, [1 / 3, 2 / 3]), (5, [0.332333, 1 / 3, 0.665667, 2 / 3])],
)
def test_thirds_are_of_the_first_the_middle_and_the_last(count, thirds):
    np.testing.assert_allclose(ways.at_thirds(count), thirds, atol=1e-6)


def test_an_engine_that_needs_a_gpu_gives_way_to_cycles(scene):
    scene.render.engine = "CYCLES"
    assert choose_engine(scene) == "" and scene.render.engine == "CYCLES"
    scene.render.engine = "BLENDER_WORKBENCH"
    note = choose_engine(scene)
    is_cycles = scene.render.engine == "CYCLES"
    assert is_cycles == (note != "") and ("Workbench needs a GPU" in note) == is_cycles


@pytest.mark.once
def test_the_report_measures_and_concludes(tolerant, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "small.blend"), copy=True)
    capfd.readouterr()
    assert run("report", "error", tmp_path / "small.blend", "--quick", "--quiet", "--json", "--out",
               tmp_path / "out") == 0  # fmt: skip
    result = json.loads(capfd.readouterr().out)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == result["files"]
    page = (tmp_path / "out" / "report.html").read_text()
    rows = {row["way"]: row for row in result["tables"]["lods"]}
    assert list(rows) == [
        "without the crowd", "full detail", "full detail, culled", "by distance, at thirds", "2 px",
        "4 px",
    ]  # fmt: skip
    assert rows["2 px"]["default"] and rows["2 px"]["missing"] == 0 < rows["2 px"]["measured"]
    assert rows["full detail, culled"]["worst_px"] <= 0.5 < rows["2 px"]["predicted_px"] <= 2.5
    assert rows["2 px"]["worst_px"] <= rows["2 px"]["predicted_px"] + 0.7
    assert rows["full detail"]["peak_mb"] > rows["without the crowd"]["peak_mb"] > 50
    assert all(row["cpu_s"] > 0 for row in rows.values())
    assert result["verdicts"]["lods"].startswith("At 2 px a frame takes ")
    assert "misses nobody" in result["verdicts"]["culling"]
    for verdict in result["verdicts"].values():
        assert escape(verdict) in page
    text = (tmp_path / "out" / "culling.csv").read_text().splitlines()
    assert "CPUs" in text[0]
    assert {float(row["missed"]) for row in csv.DictReader(text[1:]) if row["default"] == "1"} == {
        0
    }


@pytest.mark.once
def test_a_process_tells_its_progress_and_ends_with_the_steps(tmp_path):
    code = "import os, time; print(os.getpid(), 'it: 39%', flush=True); time.sleep(60)"
    steps = run_process([sys.executable, "-c", code], tmp_path / "log", patience=5.0)
    while next(steps) < 0.39:
        pass
    steps.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "log").read_text().split()[0]), 0)
    code = "print('it: 9%'); raise SystemExit('why')"
    failing = run_process([sys.executable, "-c", code], tmp_path / "log")
    assert finished(failing) == (1, "why")


def test_the_folder_is_named_after_the_file(levelled, tmp_path, monkeypatch, capfd):
    levelled.camera = None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "small.blend"), copy=True)
    (tmp_path / "small_error").write_text("a file")
    monkeypatch.chdir(tmp_path)
    assert quietly("report", "error", "small.blend") == 1
    assert "small_error" in capfd.readouterr().err
    (tmp_path / "small_error").unlink()
    assert quietly("report", "error", "small.blend") == 1
    assert "no active camera" in capfd.readouterr().err


def test_a_scene_without_a_camera_is_one_sentence(levelled, tmp_path):
    levelled.camera = None
    with pytest.raises(CrowdError, match="no active camera"):
        finished(measure(levelled, tmp_path / "out", True))
    assert not (tmp_path / "out").exists()
