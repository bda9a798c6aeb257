import os
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.radar import BLOCK, RadarOptions, lost, radar
from crowd_lod_extension.crowd_lod.validation.exact_frustum import find_visible, scatter, sees

from ..support.cameras import ONE, straight
from ..support.crowds import crowd_at
from ..support.culling_audit import LENSES, audit, gap, random_camera

FULL = bool(os.environ.get("CROWD_LOD_FULL"))


@pytest.mark.parametrize("lens", LENSES)
def test_against_exact_planes(lens):
    """The full million of pairs: CROWD_LOD_FULL=1."""
    pairs = 200_000 if FULL else 10_000
    verdict = audit(lens, pairs)
    assert verdict.pairs == pairs
    assert (
        verdict.survivors > pairs / 10 and verdict.visible < 0.95 * pairs
    )  # the judge had something to say
    assert verdict.missed == 0
    if lens != "sheared, Cycles":  # those keep what its rays may show
        assert verdict.surplus < 0.001 * verdict.survivors


@pytest.mark.parametrize("lens", LENSES)
def test_agents_within_roundings_of_a_plane_are_not_missed(lens):
    verdict = audit(lens, 20_000 if FULL else 2_000, on_planes=0.5)
    assert verdict.doubtful > 0.05 * verdict.pairs  # so close that float64 could not tell
    assert verdict.missed == 0
    assert verdict.depth_error <= 1


def test_the_judge_in_float64_agrees_with_its_rational_self():
    random = np.random.default_rng(1)
    for lens in LENSES:
        camera = random_camera(random, lens)
        radius = 10.0 ** random.uniform(-3, 1.5, 150)
        points = scatter(camera, radius, random)
        assert find_visible(camera, points, radius)[0].tolist() == [
            sees(camera, p, r) for p, r in zip(points, radius, strict=True)
        ]


def test_gap_is_the_distance_to_the_frustums_body():
    camera = straight()
    # inside, above the near face, beside the right face, past an edge, past a corner
    points = [(0, 50, 0), (0, 0, 0), (60, 50, 0), (103, 104, 0), (103, 104, 100)]
    expected = [0, 1, np.sqrt(50), 5, 5]
    np.testing.assert_allclose(gap(camera, np.array(points, float)), expected)


def test_agents_exactly_on_planes_are_visible():
    # exactly representable: unit sphere on the near, far and side planes of a camera 90 degrees
    # wide
    on = [(0, 0, 0), (0, 101, 0), (10, 10, 0), (-10, 10, 0), (0, 10, 10), (0, 10, -10)]
    visible, distance = radar(crowd_at(on), straight(), ONE, np.array([1.0]))
    assert visible.all()
    assert distance.tolist() == [0, 101, 10, 10, 10, 10]
    beyond = [(0, -1e-9, 0), (0, 101 + 1e-9, 0)]
    assert not radar(crowd_at(beyond), straight(), ONE, np.array([1.0]))[0].any()


def test_the_sphere_stands_at_its_height_above_the_feet():
    below = crowd_at([(0, 10, -14.0)])
    radius = np.array([2.0])
    assert not radar(below, straight(), np.array([0.0]), radius)[0][0]
    assert radar(below, straight(), np.array([1.2]), radius)[0][0]


def test_fixed_delta_is_the_chapters():
    # |v.X| <= w/2 + Delta at depth 10: 10 + 3; near and far are not widened
    points = [(13, 10, 0), (13.001, 10, 0), (0, 0.999, 0), (0, 100.001, 0), (0, 100, 0)]
    points += [(0, 10, 13), (0, 10, -13), (0, 10, -13.001)]
    visible, _ = radar(
        crowd_at(points), straight(), ONE, np.array([50.0]), RadarOptions(margin=3.0)
    )
    assert visible.tolist() == [True, False, False, False, True, True, True, False]


def test_panoramic_camera_keeps_all_within_range():
    points = [(0, -50, 0), (50, 0, 0), (0, 0, -99), (0, 102, 0), (0.1, 0.1, 0)]
    visible, distance = radar(crowd_at(points), straight(kind="PANO"), ONE, np.array([0.5]))
    assert visible.tolist() == [True, True, True, False, False]
    np.testing.assert_allclose(distance, np.linalg.norm(points, axis=1))


@pytest.mark.parametrize("cone", [0.2, 1.0, np.pi / 2, 2.5])
def test_fisheye_keeps_its_cone_and_nothing_far_beside_it(cone):
    random = np.random.default_rng(12)
    camera = replace(straight(kind="PANO"), cone=cone)
    points = random.uniform(-90, 90, (20_000, 3))
    radius = 2.0
    visible, _ = radar(crowd_at(points), camera, ONE, np.array([radius]))
    # a point of the sphere within the cone: try many on each
    way = random.normal(size=(60, 3))
    way *= radius / np.linalg.norm(way, axis=1, keepdims=True)
    surface = points[:, None] + way
    range_ = np.linalg.norm(surface, axis=2)
    within = (surface[..., 1] / range_ >= np.cos(cone)) & (range_ >= 1) & (range_ <= 100)
    assert not (within.any(axis=1) & ~visible).any()
    # tight: the angle between axis and center exceeds the cone by no more than the sphere's own
    center = np.linalg.norm(points, axis=1)
    ahead = center > 2 * radius
    angle = np.arccos(points[ahead, 1] / center[ahead])
    beside = angle > cone + np.arcsin(radius / center[ahead]) + 1e-9
    if cone < np.pi / 2:
        assert not (visible[ahead] & beside & (angle < cone + np.pi / 2)).any()
    assert beside.any()


def test_a_sheared_fisheye_keeps_its_cone():
    random = np.random.default_rng(12)
    axes = straight().X, straight().Y, straight().Z + 1.5 * straight().X
    camera = replace(straight(kind="PANO"), cone=1.0, Z=axes[2])
    points = random.uniform(-90, 90, (4000, 3))
    visible, _ = radar(crowd_at(points), camera, ONE, np.array([5.0]))
    way = random.normal(size=(60, 3))
    surface = points[:, None] + 5.0 * way / np.linalg.norm(way, axis=1, keepdims=True)
    away = np.linalg.norm(surface, axis=2)
    coordinates = surface @ np.transpose(axes)
    ahead = coordinates[..., 2] / np.linalg.norm(coordinates, axis=2)
    within = ((ahead >= np.cos(1)) & (away >= 1) & (away <= 100)).any(axis=1)
    assert not (within & ~visible).any() and 0.1 < within.mean() < visible.mean() < 0.9


def test_lost_agents_are_found_named_and_never_visible():
    points = np.random.default_rng(0).uniform(0, 50, (1000, 3))
    assert len(lost(crowd_at(points))) == 0
    points[[3, 900]] = [[np.nan, 5, 5], [np.inf, -np.inf, 0]]
    crowd = crowd_at(points)
    assert lost(crowd).tolist() == [3, 900]
    for kind in ("PERSP", "PANO"):
        visible, _ = radar(crowd, straight(kind=kind), ONE, np.array([1.0]))
        assert visible.sum() > 100 and not visible[[3, 900]].any()
    huge = crowd_at([[1e308, 1e308, 1e308]] * 3)  # their sum overflows, they do not
    assert len(lost(huge)) == 0


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 7])
def test_blocks_agree_with_one_agent_at_a_time(count):
    random = np.random.default_rng(count)
    points = random.uniform(-100, 100, (count, 3))
    groups = random.integers(2, size=count)
    center = np.array([0.5, 1.5])
    radius = np.array([0.7, 4.0])
    visible, distance = radar(crowd_at(points, groups), straight(), center, radius)
    assert len(visible) == len(distance) == count
    for i in range(0, count, 997):
        one, at = radar(crowd_at(points[i], groups[i : i + 1]), straight(), center, radius)
        assert one[0] == visible[i] and at[0] == distance[i]
