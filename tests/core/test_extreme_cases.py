"""Extreme cases are within their bounds, and the table tells when they are not."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.frame import stages
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation import exact_frustum, stiff_cases
from crowd_lod_extension.crowd_lod.validation.extreme_cases import (
    cases,
    judge_plan,
    judged,
    table_text,
)
from crowd_lod_extension.crowd_lod.validation.stiff_cases import BoundedError, judge_steps

PLANS = {case.name: case for case in cases(1000)}
STEPS = {case.name: case for case in stiff_cases.cases()}


def seeded(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_within_its_bounds(name):
    rows = list(judge_plan(PLANS[name], seeded(1)))
    assert [row.quantity for row in rows if not row.ok] == []
    assert len(rows) == (3 if name == "panoramic" else 4)


@pytest.mark.parametrize("name", STEPS)
def test_a_walk_is_within_its_bounds(name):
    found = list(judge_steps(STEPS[name], seeded(1)))
    assert found and all(each.ok for each in found), found


def test_speeds_beyond_the_limit_are_refused_and_no_others():
    refused = [
        name
        for name, case in STEPS.items()
        if next(judge_steps(case, seeded())).quantity.startswith("steps refused")
    ]
    assert refused == ["1,000,000 cells a step"]


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


@pytest.mark.once
def test_all_cases_are_judged_with_progress():
    steps = judged(1000, 0)
    shown = [next(steps) for _ in range(3)]
    rows = finished(steps)
    assert 0 < shown[0] < shown[1] < shown[2] < 1
    assert {row.case for row in rows} == {*PLANS, *STEPS}
    assert len(rows) > exact_frustum.DEPTHS
