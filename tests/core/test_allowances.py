"""What outlines are held to: no point off by its LOD's deviation shows more than predicted."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.planned import OVERRIDDEN, PINNED
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.validation.allowances import (
    BLURRED_APART,
    PINNED_APART,
    Allowances,
    allowances,
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


def of(frame, tolerance=1.0):
    shown = frame.buckets
    return allowances(frame, shown.order.astype(np.intp), shown.levels.astype(np.intp), tolerance)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_no_point_off_by_its_lods_deviation_lies_off_by_more_pixels_than_predicted(kind):
    random = np.random.default_rng(3)
    frame = framed(kind, LevelPolicy((0.3, 0.6)))
    camera = frame.camera
    found = of(frame, None)
    spheres = frame.trajectory.spheres
    window = camera.window
    seen = 0
    for agent in frame.buckets.order.tolist():
        way = random.normal(size=(2, 500, 3))
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        group = int(frame.crowd.group[agent])
        off = frame.trajectory.groups[group].bounds[found.level[agent]]
        center = np.array([getattr(frame.crowd, axis)[agent] for axis in "xyz"])
        center[2] += spheres.center[group]
        points = center + way[0] * random.random((500, 1)) * spheres.radius[group]
        axes = np.stack([camera.X, camera.Y, camera.Z], axis=1)
        both = [(at - camera.origin) @ axes for at in (points, points + way[1] * off)]
        flat = [at[:, :2] / (at[:, 2:] if kind == "PERSP" else 1.0) for at in both]
        inside = (flat[0] >= (window.left, window.bottom)).all(axis=1)
        inside &= (flat[0] <= (window.right, window.top)).all(axis=1) & (both[1][:, 2] > 0)
        pixels = camera.pixels_per_unit * np.linalg.norm(flat[1] - flat[0], axis=1)[inside]
        seen += inside.sum()
        if np.isfinite(found.predicted[agent]):
            assert pixels.max(initial=0) <= found.predicted[agent] == found.allowed[agent]
    assert seen > 1000


def test_who_is_allowed_more():
    frame = framed()
    agent = int(frame.buckets[2][0])

    def one(frame, tolerance):
        found = allowances(frame, np.array([agent]), np.full(1, 2), tolerance)
        return Allowances(*(values[agent] for values in vars(found).values()))

    held = one(frame, 1.0)
    assert held.level == 2 and not held.apart and 1.0 <= held.allowed < 1.8
    assert held.predicted <= held.allowed * (1 + 1e-9)
    row = np.zeros(len(frame.crowd), np.uint8)
    row[agent] = 2 | PINNED
    pinned = replace(frame, plan_row=row)
    assert not one(pinned, 1.0).apart  # it keeps the tolerance
    assert one(pinned, 0.01).apart == BLURRED_APART
    row[agent] |= OVERRIDDEN
    assert one(pinned, 0.01).apart == PINNED_APART
    far = one(frame, 0.01)
    assert not far.apart and far.predicted > far.allowed  # wrong, and not pinned
    painted = framed(bias=Bias(np.zeros((1, 1)), frame.trajectory.area))
    assert one(painted, 1.0).allowed > 3.9 * held.allowed


def test_of_lods_that_are_not_measured_and_of_panoramic_cameras_nothing_is_known():
    frame = framed(policy=LevelPolicy((0.3, 0.6)), offs=((), ()))
    found = of(frame, None)
    shown = np.zeros(len(frame.crowd), bool)
    shown[frame.buckets.order] = True
    coarse = shown & (found.level > 0)
    assert coarse.any() and np.isnan(found.allowed[coarse]).all()
    ahead = np.isfinite(found.depth) & (found.level == 0)
    assert (found.allowed[ahead] == 0).all()  # full detail is exact
    round_about = of(replace(framed(), eyes=(straight(kind="PANO"),)))
    assert np.isnan(round_about.allowed).all()
