"""The report commands, run small."""

import json
from dataclasses import replace
from itertools import groupby

import pytest
from crowd_lod_extension.crowd_lod.validation import stiff_cases
from crowd_lod_extension.crowd_lod.validation.extreme_cases import cases

from ..support.commands import quietly, run


@pytest.mark.once
def test_extremes_are_a_table_of_errors_within_their_bounds(capfd):
    """Of speeds none is refused but the one beyond the limit."""
    assert run("report", "extremes", "--most", "1000", "--quiet", "--json") == 0
    found = json.loads(capfd.readouterr().out)
    assert found["ok"] and found["wrong"] == []
    rows = found["rows"]
    assert all(row["ok"] == (row["error"] <= row["bound"]) for row in rows)
    refused = [row["case"] for row in rows if row["quantity"].startswith("steps refused")]
    assert refused == ["1,000,000 cells a step"]
    plans = [(case.name, 3 if case.name == "panoramic" else 4) for case in cases(1000)]
    steps = [(case.name, 1 if case.name in refused else 2) for case in stiff_cases.cases()]
    counts = [(name, len(list(own))) for name, own in groupby(rows, lambda row: row["case"])]
    assert counts == plans + steps
    by = {(row["case"], row["quantity"]): row for row in rows}
    assert by["1,000 agents", "agents missed"] == {
        "case": "1,000 agents", "quantity": "agents missed", "error": 0, "bound": 0, "ok": True,
    }  # fmt: skip
    assert by["walls touch at a corner", "off by cells"]["error"] > 0


@pytest.mark.once
def test_a_bound_that_is_exceeded_is_told_by_the_exit_code(monkeypatch, capfd):
    case = stiff_cases.cases()[0]
    monkeypatch.setattr(stiff_cases, "cases", lambda: [replace(case, bound=-1.0)])
    assert quietly("report", "extremes", "--most", "10") == 1
    out = capfd.readouterr().out
    assert out.count("WRONG") == 1 and case.name in out


def test_bad_input_is_one_sentence(scene, tmp_path, capfd):
    import bpy

    scene.camera = None
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "bad.blend"))
    capfd.readouterr()
    assert quietly("report", "error", tmp_path / "bad.blend", "--out", tmp_path / "out") == 1
    said = capfd.readouterr()
    assert (
        "no active camera" in said.err
        and said.err.count("\n") == 1
        and not (tmp_path / "out").exists()
    )
