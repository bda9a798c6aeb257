"""Ways to cull beside independent counts: brute rational arithmetic for each agent."""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.leave_outs import NO_MIRRORS, NO_SHADOWS, NO_SKY
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.validation import culling_errors
from crowd_lod_extension.crowd_lod.validation.culling_errors import (
    BY_EYE,
    EXACT,
    FRAMES,
    MATRIX,
    NAIVE,
    RADAR,
    SINGLE,
    SPAN,
    FrameToCull,
    compare_culling,
    exactly,
    leave_outs,
    replayed,
)
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees, standing_crowd
from crowd_lod_extension.crowd_lod.validation.extreme_cases import camera_of
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.shots import ONE, chapter, shot

NARROW, *_, WIDE = BY_EYE
CENTER = np.array([0.9, 0.5])
RADIUS = np.array([1.0, 0.4])
POLICY = LevelPolicy((0.16, 0.4))


def view(count=400, seed=3, **lens):
    random = np.random.default_rng(seed)
    points = random.uniform((-30, 0, -2), (60, 110, 2), (count, 3))
    crowd = standing_crowd(points, random.integers(2, size=count, dtype=np.uint8))
    thresholds = np.array([[16.0, 40.0], [-np.inf, np.inf]])
    return FrameToCull(crowd, camera_of(**lens), CENTER, RADIUS, thresholds)


def places(frame):
    crowd = frame.crowd
    return np.stack([crowd.x, crowd.y, crowd.z + CENTER[crowd.group]], axis=1)


@pytest.mark.parametrize(
    "lens", [{}, {"fov": 40.0, "kind": "ORTHO"}, {"kind": "PANO"}, {"fov": 150.0}]
)
def test_the_judge_agrees_with_rational_arithmetic_for_each_agent(lens):
    frame = view(**lens)
    camera = frame.camera
    found = exactly(frame)
    for i, place in enumerate(places(frame)):
        assert found.visible[i] == sees(camera, place, RADIUS[frame.crowd.group[i]])
        v = [F(float(p)) - F(float(c)) for p, c in zip(place, camera.origin, strict=True)]
        along = sum(p * F(float(q)) for p, q in zip(v, camera.Z, strict=True))
        distance = float(sum(p * p for p in v)) ** 0.5 if camera.kind == "PANO" else along
        want = 1 if frame.crowd.group[i] else sum(distance >= begin for begin in (16, 40))
        assert found.levels[i] == want
    assert 0 < found.visible.sum() < len(places(frame))


@pytest.mark.parametrize(
    "lens",
    [
        {},
        {"fov": 40.0, "kind": "ORTHO"},
        {"scale": -1.0, "direction": (-0.3, -0.9, 0.2)},
        {"fov": 150.0},
    ],
)
def test_each_way_with_a_derived_delta_sees_whom_the_judge_sees(lens):
    frame = view(4000, **lens)
    frame = replace(
        frame, camera=replace(frame.camera, window=replace(frame.camera.window, left=-0.2))
    )
    truth = exactly(frame)
    ways = culling_errors._ways(frame.camera)
    for name in (RADAR, MATRIX, NAIVE, SINGLE):
        found = ways[name](frame)
        assert (found.visible == truth.visible).all(), name
        assert (found.levels == truth.levels).all(), name
    small = ways[NARROW](frame).visible
    assert (truth.visible & ~small).any() and not (small & ~truth.visible).any()


def test_float32_in_the_world_loses_agents_far_out_and_float64_none():
    frame = view(4000)
    shift = 1e7
    crowd = replace(frame.crowd, x=frame.crowd.x + shift, y=frame.crowd.y + shift)
    camera = replace(frame.camera, origin=frame.camera.origin + (shift, shift, 0))
    far = replace(frame, crowd=crowd, camera=camera)
    truth = exactly(far)
    ways = culling_errors._ways(camera)
    assert (ways[RADAR](far).visible == truth.visible).all()
    single = ways[SINGLE](far)
    assert (single.visible != truth.visible).any() and (single.levels != truth.levels).any()


def walking(count):
    return shot(*chapter(Area(-60, -60, 60, 60)), ONE, count, 1)


def test_rows_have_the_same_truth_and_the_default_misses_nobody():
    trajectory = walking(500)
    film = camera_of(direction=(0.3, 0.9, -0.05), offset=1.0)
    rows = list(compare_culling(trajectory, [film] * SPAN, POLICY, 5, (100, 700), 1))
    by = {(row["way"], row["agents"]): row for row in rows}
    assert {row["agents"] for row in rows} == {100, 700}
    for count in (100, 700):
        assert len({row["visible"] for row in rows if row["agents"] == count}) == 1
        assert by[FRAMES, count]["missed"] == by[EXACT, count]["missed"] == 0
        assert by[FRAMES, count]["lods_off"] == 0
    assert by[WIDE, 700]["outside"] > by[RADAR, 700]["outside"] == 0
    assert [row["way"] for row in rows if row["default"]] == [FRAMES] * 2


def test_agents_that_are_not_there_are_missed_by_nobody():
    class Missing(Walk):
        def at(self, time):
            crowd = super().at(time)
            return replace(crowd, present=crowd.key % 3 > 0)

    walk = walking(300)
    trajectory = Missing(walk.start, walk.machine, walk.world, walk.groups, walk.seconds_per_frame)
    rows = list(compare_culling(trajectory, [camera_of()] * SPAN, POLICY, 5, (300,), 1))
    by = {row["way"]: row for row in rows}
    assert by[FRAMES]["missed"] == by[FRAMES]["outside"] == 0
    assert by[RADAR]["missed"] == by[RADAR]["outside"] == 0 < by[RADAR]["visible"]


def test_copies_of_agents_stand_beside_them_and_walk_alike():
    trajectory = walking(50)
    crowd = replayed(trajectory, 3, 120)
    for number in (0, 7):
        source, copy = trajectory.at(3 + number), crowd.at(3 + number)
        assert (copy.x[:50] == source.x).all() and (copy.group[50:100] == source.group).all()
        assert 0 < np.abs(copy.x[50:100] - source.x).max() <= culling_errors.AROUND
    assert len(replayed(trajectory, 3, 20).start) == 20


def test_leave_outs_are_timed_beside_the_plain_functions():
    (row,) = leave_outs(walking(30_000), camera_of(), POLICY, 5, (), 1)
    assert row["part"] == "Agents of whole blocks" and row["with_ms"] > 0 < row["without_ms"]
    assert not list(leave_outs(walking(100), camera_of(), POLICY, 5, (), 1))


def test_what_the_surroundings_lack_is_timed_as_if_there_were_one():
    beside = NO_SHADOWS, NO_MIRRORS, NO_SKY
    rows = list(leave_outs(walking(3000), camera_of(), POLICY, 5, beside, 1))
    assert [row["part"].partition(",")[0] for row in rows] == [
        "Shadows", "Mirrors", "Light of the sky",
    ]  # fmt: skip
    assert all(row["without_ms"] > 0 < row["with_ms"] for row in rows)


def test_a_crowd_that_stands_leaves_out_its_plan_and_its_steps():
    still = shot(count=30_000)
    parts = [row["part"] for row in leave_outs(still, camera_of(), POLICY, 5, (), 1)]
    assert parts == ["The plan, as nothing moves", "Steps, as nobody moves"]
