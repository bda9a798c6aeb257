from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.shot.pixels import errors_of, worst_error

from ..support.cameras import straight
from ..support.frames import shot

POLICY = LevelPolicy((0.3, 0.6))
BOUNDS = (0.0, 0.02, 0.1), (0.0, 0.05, 0.06)  # meters, of each group's LODs


def measured():
    trajectory = shot()
    groups = [
        replace(group, deviations=bounds)
        for group, bounds in zip(trajectory.groups, BOUNDS, strict=True)
    ]
    return replace(trajectory, groups=tuple(groups))


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_an_error_is_the_lods_bound_in_pixels_at_the_agents_nearest_point(kind):
    frame = plan(measured(), straight(kind=kind), POLICY, 40)
    errors = errors_of(frame)
    spheres = frame.trajectory.spheres
    assert len(np.unique(frame.buckets.levels)) == 3
    for agent, level, error in zip(frame.buckets.order, frame.buckets.levels, errors, strict=True):
        group = frame.crowd.group[agent]
        nearest = max(frame.crowd.y[agent] - spheres.radius[group], frame.camera.near)
        away = nearest if kind == "PERSP" else 1.0
        pixels = BOUNDS[group][level] * frame.camera.pixels_per_unit / away
        assert pixels * 0.999 <= error <= pixels * 1.01  # rounded up
    assert worst_error(frame) == errors.max() > 0


def test_the_worst_of_two_eyes_and_of_nobody():
    eyes = straight(offset=(-5, 0, 0)), straight(offset=(5, 0, 0))
    frame = plan(measured(), eyes, POLICY, 40)
    assert worst_error(frame) == errors_of(frame).max() > 0
    away = plan(measured(), straight(offset=(0, 900, 0)), POLICY, 40)
    assert len(errors_of(away)) == 0 and worst_error(away) == 0


def test_without_bounds_nothing_is_known():
    frame = plan(shot(), straight(), POLICY, 40)
    assert errors_of(frame) is None and worst_error(frame) is None
