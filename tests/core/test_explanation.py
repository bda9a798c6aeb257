"""What is explained of an agent, against the planes of a camera worked out by hand, and against the
radar.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window
from crowd_lod_extension.crowd_lod.culling.radar import RadarOptions, radar
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.explanation import explain_agent, sides_of
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.planned import EXCEPTED, PINNED, with_row
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.levels.cost_model import SECONDS, default_costs

from ..support.crowds import crowd_at
from ..support.shots import AREA, shot

AXES = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
# at (0, 0, 1), looks along +y, 2 units wide, from 1 to 90 m
CAMERA = Camera(
    "PERSP", np.array([0.0, 0, 1]), *AXES, Window(-1, 1, -1, 1), 1.0, 90.0, (1000, 1000)
)
SIZES = (1000, 400, 120)
GROUP = Group(
    "walker",
    0.9,
    1.0,
    0.0,
    1.0,
    SIZES,
    tuple(2 * n for n in SIZES),
    bounds=(0.0, 0.02, 0.1),
    deviations=(0.0, 0.02, 0.1),
)


def frame_of(camera=CAMERA, bias=None, **policy):
    return plan(shot(groups=(GROUP,)), camera, LevelPolicy((0.3, 0.6), **policy), 1, bias=bias)


def test_planes_are_signed_distances_in_meters():
    found = {side.name: side for side in sides_of(CAMERA, np.array([3.0, 10.0, 1.0]), 0.5, None)}
    assert found["right"].outside == pytest.approx((3 - 10) / 2**0.5) and found[
        "left"
    ].outside == pytest.approx(-13 / 2**0.5)
    assert found["top"].outside == found["bottom"].outside == pytest.approx(-10 / 2**0.5)
    assert (found["near"].outside, found["far"].outside) == (pytest.approx(-9), pytest.approx(-80))
    assert all(side.reach == pytest.approx(0.5) and side.passed for side in found.values())
    beside = {side.name: side for side in sides_of(CAMERA, np.array([11.0, 10.0, 1.0]), 0.5, None)}
    assert beside["right"].outside == pytest.approx(1 / 2**0.5) and not beside["right"].passed
    wider = {
        side.name: side for side in sides_of(CAMERA, np.array([11.0, 10.0, 1.0]), 0.0, 2.0)
    }  # a fixed margin
    assert wider["right"].outside == pytest.approx(-1 / 2**0.5) and wider["right"].passed


@pytest.mark.once
@pytest.mark.parametrize("margin", [None, 1.5])
@pytest.mark.parametrize(
    "camera", [CAMERA, replace(CAMERA, kind="ORTHO", window=Window(-9, 5, -2, 7)), replace(CAMERA, kind="PANO", cone=1.2), replace(CAMERA, kind="PANO")],
    ids=["PERSP", "ORTHO", "PANO", "PANO, all around"],
)  # fmt: skip
def test_who_passes_all_tests_is_seen_and_nobody_else(camera, margin):
    points = np.random.default_rng(4).uniform((-60, -30, -20), (60, 100, 20), (4000, 3))
    center = np.array([0.9])
    radius = np.array([1.0])
    seen, _ = radar(crowd_at(points), camera, center, radius, RadarOptions(margin))
    for at, expected in zip(points, seen, strict=True):
        found = sides_of(camera, at + (0, 0, 0.9), 1.0 if margin is None else 0.0, margin)
        assert all(side.passed for side in found) == expected
    assert 20 < seen.sum() < 3980


def test_alternatives_tell_what_each_lod_costs_and_shows():
    frame = frame_of()
    agent = int(frame.buckets[1][0])
    found = explain_agent(frame, agent, default_costs("EEVEE"))
    costs = default_costs("EEVEE").seconds
    depth = frame.depths[agent]
    for level, each in enumerate(found.alternatives):
        assert each.level == level and each.triangles == 2 * SIZES[level]
        assert each.pixels == pytest.approx((0, 0.02, 0.1)[level] * 500 / (depth - 1))
        assert each.seconds == pytest.approx(
            costs["instances"] + costs["instanced"] * 2 * SIZES[level]
        )
        assert each.mesh_seconds == pytest.approx(costs["unique"] * 2 * SIZES[level])
        assert each.companions == frame.buckets.counts[level] - (level == 1)
    assert [each.begins for each in found.alternatives] == [
        None,
        pytest.approx(27),
        pytest.approx(54),
    ]
    assert (
        explain_agent(frame, agent, default_costs("CYCLES")).alternatives[0].seconds
        == SECONDS["CYCLES"]["instances"]
    )
    assert (
        found.by_distance == found.account.level == 1 and found.distance == frame.distances[agent]
    )
    assert json.dumps(found.as_json, allow_nan=False)


def test_detail_map_and_shot_plan_are_told():
    bias = Bias(np.full((2, 2), 0.25), AREA)
    frame = frame_of(bias=bias)
    agent = int(frame.buckets[2][0])
    found = explain_agent(frame, agent, default_costs("CYCLES"))
    assert (
        found.factor == 2 and found.by_distance == 2 and "times 2 by the detail map" in found.text
    )
    row = np.full(len(frame.crowd), EXCEPTED | PINNED, np.uint8)
    pinned = explain_agent(with_row(frame, row), agent, default_costs("CYCLES"))
    assert (
        pinned.by_distance == 2
        and pinned.account.level == 0
        and pinned.account.reason == "override"
    )
    assert (
        "The shot plan: LOD 0, by an override." in pinned.text and "The shot plan" not in found.text
    )
    (marked,) = (line for line in pinned.text.splitlines() if "*" in line)
    assert marked.startswith("0*")


def test_culled_agents_are_told_by_which_side():
    frame = frame_of()
    agent = int(np.flatnonzero(~frame.visible)[0])
    found = explain_agent(frame, agent, default_costs("EEVEE"))
    assert found.text.splitlines()[1].startswith("Culled: ") and "*" not in found.text
    assert any(line.endswith("outside") for line in found.text.splitlines())
    assert sum(each.companions for each in found.alternatives) == len(frame.buckets.order)


def test_tests_of_every_eye_are_told():
    two = (CAMERA, replace(CAMERA, origin=CAMERA.origin + (0.5, 0, 0)))
    found = explain_agent(frame_of(two), 3, default_costs("EEVEE"))
    assert len(found.eyes) == 2 and found.eyes[0] != found.eyes[1] and "Side, eye 1" in found.text


def test_without_lod_meshes_costs_are_not_known():
    frame = plan(
        shot(groups=(Group("walker", 0.9, 1.0, 0.0, 1.0),)), CAMERA, LevelPolicy((0.3,)), 1
    )
    found = explain_agent(frame, 0, default_costs("EEVEE")).alternatives
    assert {(each.triangles, each.pixels, each.seconds, each.mesh_seconds) for each in found} == {
        (None, None, None, None)
    }
    with pytest.raises(CrowdError, match="no agent 400"):
        explain_agent(frame, 400, default_costs("EEVEE"))
