"""The report commands, run small."""

import csv
import json
import os
from xml.etree import ElementTree

import pytest
from crowd_lod_extension.operators.cli import commands

SVG = "{http://www.w3.org/2000/svg}"


def run(*words):
    return commands.run_command([str(word) for word in words], "crowd-lod")


@pytest.mark.once
def test_error_report_leaves_tables_and_plots(tmp_path, capfd):
    assert (
        run(
            "report",
            "error",
            "chapter",
            "--out",
            tmp_path / "out",
            "--repeats",
            1,
            "--quiet",
            "--json",
        )
        == 0
    )
    result = json.loads(capfd.readouterr().out)
    assert sorted(os.listdir(tmp_path / "out")) == sorted(result["files"])
    tables = {}
    for name in ("behavior", "culling", "drift", "levels"):
        lines = (tmp_path / "out" / f"error_{name}.csv").read_text().splitlines()
        assert "CPUs" in lines[0]
        tables[name] = list(csv.DictReader(lines[1:]))
        if name != "drift":
            drawn = ElementTree.parse(tmp_path / "out" / f"error_{name}.svg").iter(f"{SVG}path")
            assert sum(path.get("class") == "mark" for path in drawn) > len(tables[name])
    # derived Delta and exact planes agree; no Delta misses agents, a huge one keeps some for
    # nothing
    derived = [row for row in tables["culling"] if row["method"] == "derived Delta"]
    assert derived and all(float(row["missed"]) == 0 == float(row["surplus"]) for row in derived)
    fixed = {
        float(row["delta_m"]): row for row in tables["culling"] if row["method"] == "fixed Delta"
    }
    assert float(fixed[0.0]["missed"]) > 0 and float(fixed[10.0]["surplus"]) > 0
    steps = [float(row["worst_m"]) for row in tables["behavior"] if row["method"] == "step"]
    listing = [float(row["worst_m"]) for row in tables["behavior"] if row["method"] == "listing"]
    assert (
        max(steps) < 1e-9 < 0.01 < min(listing)
    )  # the chapter's walls meet its cells: only the listing overshoots
    assert float(listing[-1]) == pytest.approx(
        listing[0] / 64, rel=0.1
    )  # of first order, over 6 halvings


@pytest.mark.once
def test_extremes_are_tables_without_a_missed_or_a_broken_agent(tmp_path, capfd):
    page = tmp_path / "extremes.md"
    assert run("report", "extremes", "--most", "1000", "--quiet", "--json", "--out", page) == 0
    found = json.loads(capfd.readouterr().out)
    assert len(found["cases"]) > 20 and sum(row["missed"] for row in found["cases"]) == 0
    behavior = {row["case"]: row for row in found["behavior"]}
    assert len(behavior) > 15 and sum(row["broken"] for row in behavior.values()) == 0
    assert (
        behavior["chatter: to and fro over a border"]["stand"]
        == behavior["chatter: to and fro over a border"]["chatter"]
        > 0
    )
    assert "65536 are allowed" in behavior["1,000,000 cells a step"]["note"]
    corners = behavior["walls touch at a corner"]
    assert (
        0 < corners["stand"] < corners["agents"]
        and corners["worst"] < 1e-3
        and corners["unknown"] == 0
    )
    long_timers = behavior.pop("timers of 0.001 s, steps of 0.5 s")
    assert long_timers["stand"] == long_timers["agents"] > 0
    assert all(row["cells"] < 0.15 for row in behavior.values())
    text = page.read_text(encoding="utf-8")
    assert (
        "## Culling and LODs" in text
        and "## Behavior" in text
        and "walls touch at a corner" in text
    )


def test_bad_input_is_one_sentence(scene, tmp_path, capfd):
    import bpy

    scene.camera = None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "bad.blend"))
    capfd.readouterr()
    assert run("report", "error", tmp_path / "bad.blend", "--out", tmp_path / "out", "--quiet") == 1
    said = capfd.readouterr()
    assert (
        "no active camera" in said.err
        and said.err.count("\n") == 1
        and not (tmp_path / "out").exists()
    )
