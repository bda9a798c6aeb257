from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.reasons import account, reasons
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy, assign

from ..support.cameras import straight
from ..support.frames import shot


def test_costs_are_those_of_the_agents_counted_one_by_one():
    trajectory = shot()
    frame = plan(trajectory, straight(), LevelPolicy((0.3, 0.6)), 40)
    seen = np.flatnonzero(frame.visible)
    assert 0 < len(seen) < 3000
    group = frame.crowd.group
    level = frame.levels
    assert frame.vertices == sum(trajectory.groups[group[i]].vertices[level[i]] for i in seen)
    assert frame.full_triangles == sum(trajectory.groups[g].triangles[0] for g in group)


def test_milliseconds_of_the_stages_are_those_of_the_plan():
    trajectory = shot()
    begin = perf_counter()
    frame = plan(trajectory, straight(), LevelPolicy((0.3, 0.6)), 40)
    whole = 1000 * (perf_counter() - begin)
    assert list(frame.milliseconds) == ["behavior", "culling", "levels", "sorting"]
    assert min(frame.milliseconds.values()) > 0
    assert sum(frame.milliseconds.values()) < whole


def test_a_plan_does_not_depend_on_what_was_asked_before():
    warm = shot()
    for time in (90, 5, 33.5):
        plan(warm, straight(), LevelPolicy((0.3, 0.6)), time)
    a, b = (plan(t, straight(), LevelPolicy((0.3, 0.6)), 33.5) for t in (warm, shot()))
    assert (
        a.buckets.order.tobytes() == b.buckets.order.tobytes()
        and a.crowd.x.tobytes() == b.crowd.x.tobytes()
    )


def test_an_open_shutter_keeps_whoever_walks_through_the_picture():
    trajectory = shot()
    policy = LevelPolicy((0.3, 0.6))
    trajectory.seconds_per_frame = 8.0  # agents walk several times their size a frame
    times = (39.5, 40.0, 40.5)
    camera = straight()
    blurred = plan(trajectory, camera, policy, 40, [(time, (camera,)) for time in times])
    still = plan(trajectory, camera, policy, 40)
    assert (blurred.visible | still.visible).sum() == blurred.visible.sum() > still.visible.sum()
    assert (blurred.levels == still.levels).all()
    for time in np.linspace(39.5, 40.5, 11):
        assert not (plan(trajectory, camera, policy, float(time)).visible & ~blurred.visible).any()


def test_two_eyes_and_a_painted_bias():
    trajectory = shot()
    policy = LevelPolicy((0.3, 0.6))
    eyes = straight(offset=(-5, 0, 0)), straight(offset=(5, 0, 0))
    both = plan(trajectory, eyes, policy, 10)
    each = [plan(trajectory, eye, policy, 10).visible for eye in eyes]
    assert (both.visible == each[0] | each[1]).all() and both.camera is eyes[0]
    near_everywhere = Bias(np.ones((2, 2)), trajectory.world.area)
    finer = plan(trajectory, eyes, policy, 10, bias=near_everywhere)
    assert (finer.levels == 0).all() and both.levels.max() == 2  # 100 m count as 25


def test_distances_are_found_when_asked_for_and_once():
    trajectory = shot()
    policy = LevelPolicy((0.3, 0.6))
    eyes = straight(offset=(-5, 0, 0)), straight(offset=(5, 0, 0))
    frame = plan(
        trajectory, eyes, policy, 10, bias=Bias(np.full((2, 2), 0.6), trajectory.world.area)
    )
    assert not {"distances", "depths", "factors"} & set(vars(frame))
    spheres = trajectory.spheres
    centers = np.stack(
        [frame.crowd.x, frame.crowd.y, frame.crowd.z + spheres.center[frame.crowd.group]], axis=1
    )
    away = [centers - eye.origin for eye in eyes]
    expected = np.min([v @ eyes[0].Z for v in away], axis=0)
    found = frame.distances
    assert found == pytest.approx(expected) and frame.depths == pytest.approx(away[0] @ eyes[0].Z)
    reasons(frame), account(frame, 5)
    assert frame.distances is found
    assert (assign(found, frame.thresholds, frame.crowd.group, frame.factors) == frame.levels).all()


def test_lost_agents_are_left_out_and_counted():
    trajectory = shot()
    x = trajectory.start.x.copy()
    x[[5, 8]] = np.nan
    lost = replace(trajectory, start=replace(trajectory.start, x=x))
    frame = plan(lost, straight(), LevelPolicy(()), 1)
    assert frame.dropped == 2 and not frame.visible[[5, 8]].any() and frame.visible.any()
