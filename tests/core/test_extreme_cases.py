"""Extreme cases are within their bounds, and the table tells when they are not."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.frame import stages
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation import exact_frustum, stiff_cases
from crowd_lod_extension.crowd_lod.validation.extreme_cases import (
    BoundedError,
    cases,
    judge_case,
    judged,
    table_text,
)

ALL = tuple(cases(1000))


@pytest.mark.parametrize("name", ALL)
def test_a_plan_is_within_its_bounds(name):
    spheres = cases(1000)[name](np.random.default_rng(1))
    rows = list(judge_case(name, spheres))
    assert [row.quantity for row in rows if not row.ok] == []
    assert len(rows) == (3 if name == "panoramic" else 4)


@pytest.mark.parametrize("case", stiff_cases.cases(1), ids=lambda case: case.name)
def test_a_walk_is_within_its_bounds(case):
    found = list(stiff_cases.judge(case))
    assert found and all(error <= bound for _, error, bound in found), found


def test_speeds_beyond_the_limit_are_refused_and_no_others():
    refused = [
        case.name
        for case in stiff_cases.cases(0)
        if next(iter(stiff_cases.judge(case)))[0].startswith("steps refused")
    ]
    assert refused == ["1,000,000 cells a step"]


def test_a_fault_of_the_radar_exceeds_a_bound(monkeypatch):
    radar = stages.radar

    def without_reach(crowd, cameras, center, radius, options, agents=None):
        return radar(crowd, cameras, center, 0.9 * radius, options, agents)

    monkeypatch.setattr(stages, "radar", without_reach)
    spheres = cases(1000)["orthographic"](np.random.default_rng(0))
    assert {row.quantity for row in judge_case("it", spheres) if not row.ok} == {"agents missed"}


def test_a_walk_that_is_off_exceeds_its_bound(monkeypatch):
    at = Walk.at
    case = next(case for case in stiff_cases.cases(0) if case.name == "a map a step")
    monkeypatch.setattr(
        Walk, "at", lambda walk, time: replace(at(walk, time), x=at(walk, time).x + 1)
    )
    assert [error > bound for _, error, bound in stiff_cases.judge(case)] == [False, True]


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
    assert {row.case for row in rows} == {*ALL, *(case.name for case in stiff_cases.cases(0))}
    assert len(rows) > exact_frustum.DEPTHS
