import json
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.agents import Group
from crowd_lod_extension.crowd_lod.camera import Camera, window
from crowd_lod_extension.crowd_lod.machine import parse
from crowd_lod_extension.crowd_lod.poses import (
    LEAST,
    MOST,
    MOST_ASKED,
    MOST_RATES,
    first_poses,
    longest_step,
    path_pixels,
    played,
    pose_counts,
    pose_of,
    rates_of,
)

CAMERA = Camera(
    kind="PERSP",
    origin=np.zeros(3),
    X=np.array([1.0, 0, 0]),
    Y=np.array([0, 0, 1.0]),
    Z=np.array([0, 1.0, 0]),
    window=window(1.0, "AUTO", (1000, 1000), (1, 1), (0, 0)),
    near=0.1,
    far=1000,
    pixels=(1000, 1000),
)


LIGHT = np.array([[4000, 1000, 250]] * 3)  # vertices of LODs so small that memory does not bound their poses


@pytest.mark.parametrize("tolerance", [0.125, 0.5, 1.5])
def test_the_nearest_pose_is_off_by_less_than_the_tolerance_where_the_lod_begins(tolerance):
    path, begin, radius = np.array([2.0, 6.0, 0.3]), np.array([[40.0, 300.0]] * 3), np.full(3, 1.0)
    counts = pose_counts(path_pixels(path, begin, radius, CAMERA), LIGHT, tolerance)
    assert counts.shape == (3, 3) and set(counts.ravel()) <= {8, 16, 32, 64, 128, 256}
    for g in range(3):
        for k, distance in ((1, 39.0), (2, 299.0)):
            pixels = path[g] / counts[g, k] / 2 * 1000 / distance  # the lens's slope is 1: 1000 pixels per unit
            assert pixels <= tolerance or counts[g, k] == MOST_ASKED
            assert 2 * pixels > tolerance or counts[g, k] == LEAST  # and no more poses than that takes
    assert len(set(counts.ravel())) > 1


def test_no_lod_takes_more_memory_for_its_poses_than_the_finest_in_the_usual_number():
    pixels = np.full((2, 5), 1e6)
    vertices = np.array([[5000, 2501, 700, 40, 3], [100, 100, 90, 1, 0]])
    counts = pose_counts(pixels, vertices, 1.0)
    assert counts.tolist() == [[64, 128, 256, 256, 256], [64, 64, 64, 256, 256]]
    assert (pose_counts(pixels, vertices) == MOST).all()


def test_one_pose_where_nothing_moves_and_the_most_where_it_is_not_known():
    pixels = path_pixels(np.array([0.0, np.inf]), np.array([[5.0], [5.0]]), np.ones(2), CAMERA)
    assert pose_counts(pixels, np.ones((2, 2))).tolist() == [[1, 1], [MOST, MOST]]


def test_an_orthographic_camera_shows_a_step_as_large_at_any_distance():
    flat = replace(CAMERA, kind="ORTHO", window=window(100.0, "AUTO", (1000, 1000), (1, 1), (0, 0)))
    counts = pose_counts(path_pixels(np.array([2.0]), np.array([[-np.inf, np.inf]]), np.ones(1), flat), LIGHT[:1])
    assert counts.tolist() == [[16, 16, 16]]  # 2 m are 20 pixels


def test_the_pose_is_the_nearest_of_the_agents_own_group_at_the_rate_nearest_to_its_own():
    random = np.random.default_rng(5)
    counts, rates = np.array([8, 1, 64]), np.array([[0.0, 0.5, 1.5], [1.0, np.inf, np.inf], [0.7, 0.8, np.inf]])
    phase, group, rate = random.random(2000).astype(np.float32), random.integers(0, 3, 2000), random.random(2000) * 2
    begins = first_poses(counts, rates)
    assert begins.tolist() == [0, 24, 25, 153]
    poses = pose_of(phase, rate, group, counts, rates)
    own = poses - begins[group]
    kind, own = own // counts[group], own % counts[group]
    away = np.abs(own / counts[group] - phase)
    assert (np.minimum(away, 1 - away) <= 0.5 / counts[group] + 1e-6).all()
    off = np.abs(rates[group] - rate[:, None])
    assert (off[np.arange(2000), kind] == off.min(axis=1)).all() and len(set(zip(group, kind, strict=True))) == 6
    assert poses.dtype == np.int32
    last = np.array([np.nextafter(np.float32(1), np.float32(0))])
    assert pose_of(last, np.ones(1), np.array([0]), counts, rates).tolist() == [8]


def table(*speeds, edge="clamp"):
    """A state machine that walks at these speeds."""
    states = {f"s{i}": {"on": {"*": {"speed": speed, "heading": 90 * i}}} for i, speed in enumerate(speeds)}
    return parse(json.dumps({"version": 1, "edge": edge, "labels": {"ground": {"color": "#808080"}}, "states": states}), "test")


def test_an_action_has_a_rate_for_each_speed_if_it_plays_by_the_way_and_one_if_by_time():
    groups = Group("a", 1, 1, stride=2.0, period=1.0), Group("b", 1, 1, stride=0.0, period=0.5), Group("c", 1, 1, stride=0.0, period=0.0)
    inf = np.inf
    assert rates_of(groups, table(1.0, 3.0, 1.0)).tolist() == [[0.5, 1.5], [2.0, inf], [0.0, inf]]
    assert rates_of(groups[:1], table(1.0, 0.0)).tolist() == [[0.0, 0.5]]
    assert rates_of(groups[:1], table(1.0, edge="stop")).tolist() == [[0.0, 0.5]]  # who stands at the map's edge
    many = rates_of(groups[:1], table(*range(11)))[0]
    assert len(many) == MOST_RATES and many[0] == 0 and many[-1] == 5 and (np.diff(many) > 0.9).all()


def test_the_way_of_a_phase_goes_the_short_way_round():
    opens, closes = np.float32([0.2, 0.98, 0.5, 0.01]), np.float32([0.3, 0.02, 0.5, 0.99])
    phase, change = played(opens, closes)
    np.testing.assert_allclose(phase, [0.25, 0.0, 0.5, 0.0], atol=1e-7)
    np.testing.assert_allclose(change, [0.1, 0.04, 0, -0.02], atol=1e-7)
    assert (phase >= 0).all() and (phase < 1).all()


def test_the_longest_step_is_that_of_the_vertex_which_moves_most():
    one = np.zeros((3, 3))
    other = np.array([[0, 0, 1.0], [3, 4, 0], [0, 2, 0]])
    assert longest_step(one, other) == 5 and longest_step(one, other[:2]) == np.inf and longest_step(one[:0], one[:0]) == 0
