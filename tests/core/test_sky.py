"""Agents near what the picture shows stay where a sky lights it, and no others for that."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.volumes import Mirror
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.shadows import SKY_REACH, Surroundings, surround
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy

from ..support.cameras import straight
from ..support.culling_audit import gap
from ..support.frames import shot

SKY = Surroundings(sky=True)
POLICY = LevelPolicy((0.3, 0.6))


@pytest.fixture(scope="module")
def trajectory():
    return shot()


def kept(trajectory, camera, around=SKY, shutter=()):
    """(kept, distances to the frustum in radii, visible), each (n,)."""
    frame = surround(plan(trajectory, camera, POLICY, 1, shutter), around)
    found = np.zeros(len(frame.crowd), bool)
    found[frame.shadow.order] = True
    centers = np.stack(frame.crowd.places(trajectory.spheres.center), axis=1)
    radius = trajectory.spheres.reach[frame.crowd.group]
    return found, gap(camera, centers) / radius, frame.visible


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("height", [1.7, 8.0])
def test_agents_near_the_picture_stay_and_those_far_from_it_do_not(trajectory, kind, height):
    camera = straight(60.0, kind, (0, 20, height))
    found, away, visible = kept(trajectory, camera)
    near = away <= 1 + SKY_REACH
    assert (found | visible)[near].all()
    assert (found & ~visible).sum() >= 20
    # beside an edge of the frustum a sphere touches both planes that meet there
    assert away[found].max() <= 2 * (1 + SKY_REACH)


def test_without_a_sky_nobody_stays_for_it(trajectory):
    found, _, _ = kept(trajectory, straight(60.0), Surroundings())
    assert not found.any()


def test_large_agents_stay_from_farther_off(trajectory):
    giants = replace(trajectory.groups[0], radius=3.0)
    large = shot((giants, trajectory.groups[1]))
    camera = straight(60.0, offset=(0, 20, 1.7))
    found, away, _ = kept(large, camera)
    radius = large.spheres.reach[large.start.group]
    beyond = away * radius > 2 * (1 + SKY_REACH)
    assert (radius[found & beyond] == 3.0).all() and (found & beyond).any()


def test_they_stay_for_what_a_mirror_shows_too(trajectory):
    camera = straight(offset=(0, 70, 1.7))
    corners = np.array([(-30, 90, 0), (30, 90, 0), (30, 90, 9), (-30, 90, 9)], float)
    mirror = Mirror(np.array([0, 1.0, 0]), corners)
    alone, _, _ = kept(trajectory, camera)
    both, _, _ = kept(trajectory, camera, replace(SKY, mirrors=(mirror,)))
    assert (both & ~alone).any()


def test_an_open_shutter_keeps_whoever_is_near_at_any_of_its_times(trajectory):
    cameras = [straight(60.0, offset=(x, 20, 1.7)) for x in (-4.0, 0.0, 4.0)]
    shutter = [(time, (each,)) for time, each in zip((0.5, 1.0, 1.5), cameras, strict=True)]
    blurred, _, seen = kept(trajectory, cameras[1], shutter=shutter)
    for camera in cameras:
        found, away, _ = kept(trajectory, camera)
        assert not (found & (away <= 1 + SKY_REACH) & ~blurred & ~seen).any()
