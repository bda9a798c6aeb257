"""The files that Plan Shot writes beside the plan."""

import csv
import io
import json

import bpy
import pytest
from crowd_lod_extension.crowd_lod.shot import plan_file

from ..support.pages import Reader


def files_of(scene, folder):
    """The names and bytes of the files that Plan Shot writes into the folder, of a zoom towards the
    crowd.
    """
    settings = scene.crowd_lod
    lens = scene.camera.data
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 4.0
    for frame, lens.lens in ((1, 15), (12, 200)):
        lens.keyframe_insert("lens", frame=frame)
    settings.frames = "1:12"
    settings.output_folder = str(folder)
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    return {path.name: path.read_bytes() for path in (folder / "plan").iterdir()}


def test_files_agree_and_come_out_the_same_again(levelled, tmp_path):
    found = files_of(levelled, tmp_path / "one")
    again = files_of(levelled, tmp_path / "again")
    assert found.keys() == again.keys() >= {"plan.npz", "plan.json", "switches.csv", "report.html"}
    assert all(found[name] == again[name] for name in ("plan.npz", "switches.csv"))
    told, own = (json.loads(each["plan.json"])["shot"] for each in (found, again))
    assert told == own
    rows = list(csv.DictReader(io.StringIO(found["switches.csv"].decode())))
    switches = [row for row in rows if row["from"]]
    assert len(switches) == told["plan"]["switches"] > 0
    assert max(float(row["change_px"]) for row in switches) == pytest.approx(
        told["plan"]["largest_switch_pixels"], abs=1e-3
    )
    stored = plan_file.read(tmp_path / "one" / "plan" / "plan.npz")
    for row in switches:
        frame = int(row["frame"])
        agent = int(row["agent"])
        before, after = (
            int(stored.row(f, levelled.crowd_lod.count)[agent]) for f in (frame - 2, frame - 1)
        )
        assert (before, after) == (int(row["from"]), int(row["to"]))


def test_report_tells_the_stages_and_the_curve(levelled, tmp_path):
    found = files_of(levelled, tmp_path / "one")
    read = Reader(found["report.html"].decode())
    assert {"behavior", "culling", "levels", "sorting"} <= set(
        read.texts
    ) and "Milliseconds by stage" in read.texts
    curve = json.loads(found["plan.json"])["shot"]["curve"]
    assert curve["agents"] == levelled.crowd_lod.count
    own = [point for point in curve["points"] if point["kind"] == "plan"]
    assert own[0]["switches"] == json.loads(found["plan.json"])["shot"]["plan"]["switches"]
    assert {point["kind"] for point in curve["points"]} == {
        "plan",
        "thresholds",
        "hysteresis",
        "tolerance",
        "pop_reduction",
    }
