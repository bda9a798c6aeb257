"""Blur of motion and focus against points that are projected one by one."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.culling.camera import lens_blur
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.shot.pixels import blur_of
from crowd_lod_extension.crowd_lod.shot.recording import begin_recording
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.cameras import straight
from ..support.crowds import crowd_at, walker
from ..support.shots import chapter

GROUP = replace(walker(), bounds=(0.0, 0.02, 0.2), deviations=(0.0, 0.02, 0.2), diagonal=2.0)
POLICY = LevelPolicy((0.0, 0.0), tolerance=1.0)
PLACES = [(0, 10, 0), (3, 20, 0), (-6, 40, 0), (1, 80, 0)]


@pytest.fixture
def crowd():
    return Walk(crowd_at(PLACES), *chapter(Area(-100, -100, 100, 100)), (GROUP,), 1 / 24)


def panned(camera, angle):
    """The camera, turned about z."""
    c = np.cos(angle)
    s = np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return replace(camera, X=turn @ camera.X, Z=turn @ camera.Z)


def pixels(camera, place):
    """Where a point lies in the picture, by hand: 100 pixels over 90 degrees."""
    x, y, z = np.subtract(place, camera.origin)
    across = x * camera.X[0] + y * camera.X[1]
    depth = x * camera.Z[0] + y * camera.Z[1]
    return np.array([50 * across / depth, 50 * z / depth])


def test_a_pan_blurs_by_the_way_over_the_picture(crowd):
    camera = straight()
    shutter = [(1.0, (panned(camera, angle),)) for angle in (-0.02, 0.0, 0.02)]
    frame = plan(crowd, camera, POLICY, 1.0, shutter)
    now = frame.crowd
    for agent, found in enumerate(blur_of(frame, np.arange(len(PLACES)))):
        center = now.x[agent], now.y[agent], now.z[agent] + 0.9
        way = pixels(shutter[2][1][0], center) - pixels(shutter[0][1][0], center)
        assert found == pytest.approx(np.hypot(*way), rel=1e-9) and found > 1


def test_focus_blurs_by_the_circle_of_the_sharpest_part(crowd):
    camera = lens_blur(straight(), 0.05, 20.0)
    frame = plan(crowd, camera, POLICY, 1.0)
    found = blur_of(frame, np.arange(len(PLACES)))
    for agent, blur in enumerate(found):
        depth = frame.crowd.y[agent]
        circles = [
            2 * 50 * 0.05 * abs(1 / z - 1 / 20) for z in np.linspace(depth - 1, depth + 1, 2001)
        ]
        assert blur == pytest.approx(min(circles), abs=1e-6)
    assert found[1] == 0 < found[0]  # its sphere holds the plane of focus


def test_lods_are_coarser_by_the_blur_and_no_more(crowd):
    camera = straight()
    shutter = [(1.0, (panned(camera, angle),)) for angle in (-0.02, 0.0, 0.02)]
    frame = plan(crowd, camera, POLICY, 1.0, shutter)
    cast = Cast(np.zeros(1, np.intp))
    recordings = [
        begin_recording([1], [1.0], crowd.start.group, cast.first(crowd.gaits), cast)
        for _ in range(2)
    ]
    recordings[1].tolerance = 1.0
    recordings[1].bounds = np.array([GROUP.bounds])
    for recording in recordings:
        with recording:
            recording.append(frame)
    plain, blurred = (recording.make_survey() for recording in recordings)
    blur = blur_of(frame, np.arange(len(PLACES)))
    coarser = 0
    for agent in frame.buckets.order:
        scale = float(plain.cells.row(plain.scale, 0)[agent])
        allowed = [k for k, bound in enumerate(GROUP.bounds) if scale * bound <= 1.0 + blur[agent]]
        coarsest = blurred.cells.row(blurred.coarsest, 0)[agent]
        assert coarsest in (max(allowed), max(allowed) - 1)
        assert scale * GROUP.bounds[coarsest] <= (1.0 + blur[agent]) * 1.001
        coarser += coarsest > plain.cells.row(plain.coarsest, 0)[agent]
    assert coarser > 0
