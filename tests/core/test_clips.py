"""Who appears or vanishes at once: culled by the near or far clip alone in the frame beside."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.shot.recording import begin_recording
from crowd_lod_extension.crowd_lod.shot.survey import Cause
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.cameras import straight
from ..support.crowds import crowd_at
from ..support.shots import ONE, chapter

AHEAD = [(0, 6, 0), (2, 30, 0), (-3, 60, 0)]
BEHIND = [(0, -6, 0), (2, -30, 0)]
BESIDE = [(70, 60, 0)]


def turned(camera):
    """The camera, turned round about z."""
    return replace(camera, X=-camera.X, Z=-camera.Z)


def events(before, after):
    """[who enters, who leaves], with the causes, in a shot of two frames with these cameras."""
    people = crowd_at(AHEAD + BEHIND + BESIDE)
    crowd = Walk(people, *chapter(Area(-100, -100, 100, 100)), ONE, 1 / 24)
    cast = Cast(np.zeros(1, np.intp))
    recording = begin_recording([1, 2], [1.0, 1.0], people.group, cast.first(crowd.gaits), cast)
    frames = [plan(crowd, camera, LevelPolicy((0.3, 0.6)), 1.0) for camera in (before, after)]
    with recording:
        recording.append(frames[0])
        recording.append(frames[1], frames[0])
    survey = recording.make_survey()
    return [survey.entered[1].tolist(), survey.left[1].tolist()]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_clip_that_moves_shows_and_hides(kind):
    camera = straight(kind=kind)
    near = replace(camera, near=20.0)
    far = replace(camera, far=45.0)
    assert events(near, camera) == [[(0, Cause.NEAR)], []]
    assert events(camera, near) == [[], [(0, Cause.NEAR)]]
    assert events(far, camera) == [[(2, Cause.FAR)], []]
    assert events(near, far) == [[(0, Cause.NEAR)], [(2, Cause.FAR)]]


def test_who_stood_behind_the_camera_or_beside_the_picture_does_not_appear_by_a_clip():
    camera = straight()
    assert events(turned(camera), camera) == [[], []]
    wide = replace(camera, window=replace(camera.window, right=2.0), far=100.0)
    assert events(replace(camera, far=45.0), wide) == [[(2, Cause.FAR)], []]
