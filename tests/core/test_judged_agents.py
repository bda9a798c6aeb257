"""Who is judged alone, and what they are held to: no point off by its LOD's deviation shows more
than predicted.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.planned import OVERRIDDEN, PINNED
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.validation.judged_agents import (
    BLURRED_APART,
    PINNED_APART,
    choose_agents,
)

from ..support.cameras import straight
from ..support.frames import shot

TOLERANT = LevelPolicy((0.0, 0.0), tolerance=1.0)


def framed(kind="PERSP", policy=TOLERANT, offs=((0, 0.1, 0.4), (0, 0.05, 1.5)), **more):
    trajectory = shot()
    groups = tuple(
        replace(group, deviations=off) for group, off in zip(trajectory.groups, offs, strict=True)
    )
    return plan(replace(trajectory, groups=groups), straight(kind=kind), policy, 20, **more)


def judged(frame, tolerance=1.0, number=20, count=10):
    return choose_agents(
        frame,
        frame.buckets.order.astype(np.intp),
        frame.buckets.levels.astype(np.intp),
        tolerance,
        number,
        count,
    )


def test_the_worst_come_first_others_by_chance_and_each_kind_before_any_twice():
    frame = framed()
    found = judged(frame)
    assert len(found) == 20 == len({each.agent for each in found})
    used = [
        each.predicted / each.allowed for each in judged(frame, count=3000)
    ]  # of what is allowed there
    assert [each.predicted / each.allowed for each in found[:10]] == pytest.approx(
        sorted(used, reverse=True)[:10]
    )
    assert [each.agent for each in judged(frame)] == [each.agent for each in found]
    assert [each.agent for each in judged(frame, number=21)][10:] != [each.agent for each in found][
        10:
    ]
    kinds = {(each.group, each.level) for each in judged(frame, count=3000)[10:]}
    assert len({(each.group, each.level) for each in found[10:]}) == min(10, len(kinds)) > 2


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_no_point_off_by_its_lods_deviation_lies_off_by_more_pixels_than_predicted(kind):
    random = np.random.default_rng(3)
    frame = framed(kind, LevelPolicy((0.3, 0.6)))
    camera = frame.camera
    for each in judged(frame, None):
        way = random.normal(size=(2, 2000, 3))
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        off = frame.trajectory.groups[each.group].bounds[each.level]
        z = frame.trajectory.spheres.center[each.group]
        center = np.array(
            [frame.crowd.x[each.agent], frame.crowd.y[each.agent], frame.crowd.z[each.agent] + z]
        )
        points = (
            center + way[0] * random.random((2000, 1)) * frame.trajectory.spheres.radius[each.group]
        )
        axes = np.stack([camera.X, camera.Y, camera.Z], axis=1)
        both = [(at - camera.origin) @ axes for at in (points, points + way[1] * off)]
        flat = [at[:, :2] / (at[:, 2:] if kind == "PERSP" else 1.0) for at in both]
        w = each.window
        inside = (flat[0] >= (w.left, w.bottom)).all(axis=1) & (flat[0] <= (w.right, w.top)).all(
            axis=1
        )
        pixels = camera.pixels_per_unit * np.linalg.norm(flat[1] - flat[0], axis=1)[inside]
        assert inside.any() and pixels.max() <= each.predicted == each.allowed


def test_who_is_allowed_more():
    frame = framed()
    pinned = np.zeros(len(frame.crowd), np.uint8)
    agent = int(frame.buckets[2][0])
    pinned[agent] = 2 | PINNED
    near = replace(frame, plan_row=pinned)
    levels = np.full(1, 2)
    (held,) = choose_agents(frame, np.array([agent]), levels, 1.0, 20)
    assert (
        not held.apart and 1.0 <= held.allowed < 1.8 and held.predicted <= held.allowed * (1 + 1e-9)
    )
    (within,) = choose_agents(near, np.array([agent]), levels, 1.0, 20)
    assert not within.apart  # it keeps the tolerance
    (apart,) = choose_agents(near, np.array([agent]), levels, 0.01, 20)
    assert apart.apart == BLURRED_APART
    pinned[agent] |= OVERRIDDEN
    (asked,) = choose_agents(near, np.array([agent]), levels, 0.01, 20)
    assert asked.apart == PINNED_APART
    (far,) = choose_agents(frame, np.array([agent]), levels, 0.01, 20)
    assert not far.apart and far.predicted > far.allowed  # wrong, and not pinned
    painted = framed(bias=Bias(np.zeros((1, 1)), frame.trajectory.area))
    (less,) = choose_agents(painted, np.array([agent]), levels, 1.0, 20)
    assert less.allowed > 3.9 * held.allowed


def test_of_lods_that_are_not_measured_and_of_panoramic_cameras_nothing_is_known():
    frame = framed(policy=LevelPolicy((0.3, 0.6)), offs=((), ()))
    assert {(each.predicted, each.allowed) for each in judged(frame, None)} == {(None, None)}
    assert judged(replace(frame, eyes=(straight(kind="PANO"),))) == []
    assert (
        judged(
            replace(
                frame,
                buckets=replace(
                    frame.buckets, order=np.empty(0, np.int32), offsets=np.zeros(4, np.intp)
                ),
            )
        )
        == []
    )
