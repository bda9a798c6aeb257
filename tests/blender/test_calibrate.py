"""Calibrate: costs of this machine, found by renders and kept in the user's folder."""

import json
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta

import bpy
import pytest
from crowd_lod_extension.crowd_lod.levels.cost_model import DEVELOPERS, SECONDS
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.machine_costs import (
    Calibration,
    calibration_of,
    costs_of,
    costs_path,
    key_of,
    store_fit,
)
from crowd_lod_extension.operators.runs.calibrate import Effort, calibrate
from crowd_lod_extension.operators.runs.trial_crowds import TrialCrowd

FEW = (
    TrialCrowd(0, 2, 2, 8),
    TrialCrowd(0, 40, 2, 8),
    TrialCrowd(0, 2, 2, 20_000),
    TrialCrowd(2, 2, 2, 8),
    TrialCrowd(2, 3, 1, 300, 12.0),
)


@pytest.fixture(autouse=True)
def users(tmp_path, monkeypatch):
    """A user's folder without costs."""
    monkeypatch.setenv("BLENDER_USER_CONFIG", str(tmp_path))


@pytest.fixture
def cycles():
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 4
    return scene


def fit_for(scene, days=0, **other):
    made = datetime.now(UTC) - timedelta(days=days)
    seconds = dict.fromkeys(SECONDS["CYCLES"], 1.0)
    key = key_of(scene) | other
    return Calibration(**key, seconds=seconds, date=made.isoformat(), off=0.1, renders=20)


@pytest.mark.once
def test_renders_find_the_costs_of_this_machine(cycles):
    blocks = set(bpy.data.user_map())
    kept = finished(calibrate(cycles, Effort(FEW, 64, 1)))
    assert set(bpy.data.user_map()) == blocks
    assert kept == calibration_of(cycles) and kept.age == "less than a day old"
    assert kept.renders == 10 and kept.device == "CPU"
    costs = costs_of(cycles)
    assert costs.seconds == kept.seconds and costs.basis.startswith("this machine (CPU)")
    # any processor of these years
    assert 1e-8 < costs.seconds["unique"] + costs.seconds["posed"] < 1e-4
    assert 1e-7 < costs.seconds["instances"] < 1e-3


def test_a_calibration_that_is_ended_leaves_nothing(cycles):
    store_fit(fit_for(cycles, days=3))
    before = costs_path().read_bytes()
    blocks = set(bpy.data.user_map())
    steps = calibrate(cycles, Effort(FEW[:1], 32, 1))
    next(steps)
    assert set(bpy.data.user_map()) != blocks
    steps.close()
    assert set(bpy.data.user_map()) == blocks
    with pytest.raises(Exception, match="renders took longer with a crowd than without"):
        finished(calibrate(cycles, Effort(FEW[:1], 32, 1)))
    assert costs_path().read_bytes() == before
    assert calibration_of(cycles).age == "3 days old"


def test_costs_hold_for_one_machine_device_version_and_engine(cycles):
    assert costs_of(cycles).basis == DEVELOPERS["CYCLES"]
    own = fit_for(cycles)
    for name in ("machine", "device", "blender"):
        store_fit(replace(own, **{name: "another"}))
    assert costs_of(cycles).basis == DEVELOPERS["CYCLES"]
    store_fit(own)
    assert costs_of(cycles).seconds == own.seconds
    newer = replace(own, renders=30)
    store_fit(newer)
    assert calibration_of(cycles) == newer and len(json.loads(costs_path().read_text())) == 4
    cycles.render.engine = "BLENDER_WORKBENCH"
    assert costs_of(cycles).basis == DEVELOPERS["EEVEE"]


def test_a_spoilt_file_is_as_none(cycles):
    row = asdict(fit_for(cycles))
    for spoilt in (
        "no JSON",
        "[1]",
        json.dumps([row | {"other": 1}]),
        json.dumps([row | {"seconds": {"unique": 1.0}}]),
        json.dumps([row | {"engine": "LUX"}]),
        json.dumps([row | {"seconds": dict.fromkeys(SECONDS["CYCLES"], "much")}]),
    ):
        store_fit(fit_for(cycles))
        costs_path().write_text(spoilt)
        assert costs_of(cycles).basis == DEVELOPERS["CYCLES"], spoilt
