"""The table of extreme cases tells what is beyond its bound.

All cases are judged by test_report_commands.py in tests/blender.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.frame import stages
from crowd_lod_extension.crowd_lod.validation import stiff_cases
from crowd_lod_extension.crowd_lod.validation.extreme_cases import cases, judge_plan, table_text
from crowd_lod_extension.crowd_lod.validation.stiff_cases import BoundedError, judge_steps

pytestmark = pytest.mark.once  # about texts, the same on every Blender

PLANS = {case.name: case for case in cases(1000)}
STEPS = {case.name: case for case in stiff_cases.cases()}


def seeded(seed=0):
    return np.random.default_rng(seed)


def test_a_fault_of_the_radar_exceeds_a_bound(monkeypatch):
    radar = stages.radar

    def without_reach(crowd, cameras, center, radius, options, agents=None):
        return radar(crowd, cameras, center, 0.9 * radius, options, agents)

    monkeypatch.setattr(stages, "radar", without_reach)
    rows = judge_plan(PLANS["orthographic"], seeded())
    assert {row.quantity for row in rows if not row.ok} == {"agents missed"}


def test_a_walk_that_is_off_exceeds_its_bound(monkeypatch):
    at = Walk.at
    monkeypatch.setattr(
        Walk, "at", lambda walk, time: replace(at(walk, time), x=at(walk, time).x + 1)
    )
    assert [each.ok for each in judge_steps(STEPS["a map a step"], seeded())] == [True, False]


def test_the_table_says_which_bound_is_exceeded():
    rows = [
        BoundedError("one", "agents missed", 0, 0),
        BoundedError("two", "LODs off", 3, 0),
        BoundedError("three", "off by cells", float("nan"), 0.1),
    ]
    lines = table_text(rows).splitlines()
    assert [line.split()[-1] for line in lines[1:]] == ["ok", "WRONG", "WRONG"]
