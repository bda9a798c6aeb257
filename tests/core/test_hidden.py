"""Frames without the agents that scenery hides, and what is kept of these."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import lens_blur
from crowd_lod_extension.crowd_lod.culling.occluders import join_occluders
from crowd_lod_extension.crowd_lod.culling.shutter import open_shutter
from crowd_lod_extension.crowd_lod.culling.volumes import Light, Mirror
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.reasons import Reason, reasons
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.output.tables import row
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.shots import ONE, chapter, shot
from ..support.streets import blocked_by_boxes, box_mesh, find_seen, looking, pictured
from .test_shadows import hidden_from

pytestmark = pytest.mark.once

SUN = Light(None, np.array([0.45, 0.55, -0.7]) / np.linalg.norm([0.45, 0.55, -0.7]), angle=0.01)
LAMP = Light(np.array([20.0, 30, 25]), np.array([0, 0, -1.0]), 0.5)
BOXES = np.array([[(x, y, 0), (x + 30, y + 30, 12)] for x in (-75, -35, 5, 45) for y in (5, 45)])
HOUSES = join_occluders([box_mesh(*box) for box in BOXES.astype(float)])
GROUND = np.array([(-90.0, -20, 0), (90, 90, 12)])


@pytest.fixture(scope="module")
def crowd():
    """People who walk in front of houses, between them and behind them."""
    return shot(*chapter(Area(-90, -20, 90, 90)), ONE, 1500, 2)


def planned(crowd, camera, shutter=(), **around):
    frame = plan(crowd, camera, LevelPolicy((0.1, 0.4)), 1, shutter)
    surroundings = Surroundings(occluders=HOUSES, box=GROUND, **around)
    return surround(frame, surroundings), surround(frame, replace(surroundings, occluders=None))


def centers_of(frame, agents):
    return np.stack(frame.crowd.places(frame.trajectory.spheres.center, agents), axis=1)


def test_hidden_agents_are_in_no_bucket_and_are_told(crowd):
    frame, whole = planned(crowd, looking((0, -15, 1.7), np.pi / 2))
    hidden = np.flatnonzero(frame.hidden)
    assert len(hidden) > 200
    everyone = np.sort(np.concatenate([frame.buckets.order, hidden]))
    np.testing.assert_array_equal(everyone, np.sort(whole.buckets.order))
    assert frame.triangles < whole.triangles
    assert (reasons(frame)[hidden] == Reason.BEHIND_SCENERY).all()
    columns = row(1, frame, {})
    assert columns["hidden"] == len(hidden)
    assert columns["occlusion_ms"] > 0
    assert "hidden" not in row(1, whole, {})


@pytest.mark.parametrize("light", [SUN, LAMP])
def test_a_hidden_agent_whose_shadow_may_be_seen_is_kept(crowd, light):
    random = np.random.default_rng(0)
    camera = looking((0, -15, 1.7), np.pi / 2 - 0.3, -0.1)
    frame, _ = planned(crowd, camera, lights=(light,))
    gone = frame.hidden.copy()
    gone[frame.shadow.order] = False
    assert gone.sum() > 50
    assert frame.hidden[frame.shadow.order].sum() > 20
    points = random.uniform((-90, -20, 0), (90, 90, 3), (60_000, 3))
    points[::2, 2] = 0
    points = points[pictured(camera, points)]
    points = points[~blocked_by_boxes(BOXES, camera, points)]
    points = points[np.argsort(-points[:, 1])][:1500]
    gone = np.flatnonzero(gone)
    assert not hidden_from(light, points, random, centers_of(frame, gone), 0.9).any()


def test_a_hidden_agent_does_not_stay_for_the_sky_and_one_beside_the_picture_does(crowd):
    camera = looking((0, -15, 1.7), np.pi / 2 - 0.3, -0.1)
    frame, _ = planned(crowd, camera, sky=True)
    assert frame.hidden.sum() > 50
    assert not frame.hidden[frame.shadow.order].any() and len(frame.shadow.order) > 20


def test_a_hidden_agent_in_a_mirror_is_kept(crowd):
    corners = np.array([(-40.0, 85, 0), (40, 85, 0), (40, 85, 40), (-40, 85, 40)])
    mirror = Mirror(np.array([0, 1.0, 0]), corners)
    frame, whole = planned(crowd, looking((0, -15, 8), np.pi / 2), mirrors=(mirror,))
    mirrored = np.zeros(len(frame.crowd), bool)
    mirrored[frame.mirrored.order] = True
    assert (mirrored & frame.hidden).any()
    alone = planned(crowd, looking((0, -15, 8), np.pi / 2))[0]
    assert (alone.hidden == frame.hidden).all()


def test_hidden_at_all_times_and_from_all_eyes(crowd):
    way = [looking((x, -15, 1.7), np.pi / 2) for x in (-1.0, 0, 1)]
    shutter = [(1 + 0.25 * k, (each,)) for k, each in enumerate(open_shutter(way))]
    hidden = planned(crowd, way[1], shutter)[0].hidden
    assert hidden.sum() > 50
    for each in way:
        frame, whole = planned(crowd, each)
        assert not (hidden & whole.visible & ~frame.hidden).any()
    random = np.random.default_rng(0)
    for k, between in enumerate(looking((x, -15, 1.7), np.pi / 2) for x in (-0.5, 0.5)):
        then = plan(crowd, between, LevelPolicy((0.1, 0.4)), 1.125 + 0.25 * k)
        centers = centers_of(then, np.flatnonzero(hidden))
        assert not find_seen(
            random, between, centers, 0.9, partial(blocked_by_boxes, BOXES), 20
        ).any()
    pair = way[0], way[2]
    both = planned(crowd, pair)[0].hidden
    assert both.any()
    for each in pair:
        frame, whole = planned(crowd, each)
        assert not (both & whole.visible & ~frame.hidden).any()


def test_a_lens_that_blurs_hides_nobody(crowd):
    camera = lens_blur(looking((0, -15, 1.7), np.pi / 2), 0.02, 5.0)
    frame, whole = planned(crowd, camera)
    assert not frame.hidden.any()
    np.testing.assert_array_equal(frame.buckets.order, whole.buckets.order)
