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
    Motion,
    beside,
    blended,
    chord,
    first_poses,
    longest_step,
    path_pixels,
    pixels_per_metre,
    played,
    pose_counts,
    pose_of,
    rates_of,
    rounded,
    shared,
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


def curve(count, kink=0.0, power=3):
    """A vertex's way in a cycle, (count, 2) metres: a closed curve; with `kink` it also turns sharply twice."""
    phase = np.arange(count) / count
    angle = 2 * np.pi * phase
    x = np.cos(angle) + 0.3 * np.sin(power * angle)
    return np.stack([x, np.sin(angle) + kink * np.abs((phase - 0.37) % 1 - 0.5)], axis=1)


def of_curve(kink=0.0):
    """The Motion of `curve`, by what its docstring says of it."""
    way = curve(2 * MOST, kink)
    longest = np.linalg.norm(np.roll(way[::2], -1, axis=0) - way[::2], axis=1).max()
    rough, fine = (
        np.linalg.norm((way[::step] + np.roll(way[::step], -1, axis=0)) / 2 - way[step // 2 :: step], axis=1).max()
        for step in (4, 2)
    )
    return Motion(MOST * longest, (rough, fine))


@pytest.mark.parametrize("kink", [0.0, 4.0])
@pytest.mark.parametrize("count", [16, 32, 64, 128, 256])
def test_what_lies_between_two_poses_is_off_by_the_chord(count, kink):
    motion, fine = of_curve(kink), 8192
    way, poses = curve(fine, kink), curve(count, kink)
    phase = np.arange(fine) / fine
    nearest = np.rint(phase * count).astype(int) % count
    step, share = beside(phase, np.full(fine, count), np.ones(fine, bool))
    other = poses[(nearest + step) % count]
    off = np.linalg.norm(poses[nearest] + share[:, None] * (other - poses[nearest]) - way, axis=1).max()
    expected = chord(np.array([motion.bends]), np.array([[count]]))[0, 0]
    assert off / 1.6 < expected < 3 * off
    assert off < np.linalg.norm(poses[nearest] - way, axis=1).max() / 2


def test_the_pose_beside_lies_on_the_other_side_of_the_phase_and_not_beyond_the_end_of_an_open_action():
    phase = np.array([0.0, 0.1, 0.125, 0.2, 0.9, 0.97])
    step, share = beside(phase, np.full(6, 8), np.ones(6, bool))
    np.testing.assert_allclose(share, [0, 0.2, 0, 0.4, 0.2, 0.24], atol=1e-6)
    nearest = np.rint(phase * 8)
    np.testing.assert_allclose((nearest + step * share) / 8, phase, atol=1e-6)
    _, share = beside(phase, np.full(6, 8), np.zeros(6, bool))
    np.testing.assert_allclose(share, [0, 0.2, 0, 0.4, 0, 0], atol=1e-6)


@pytest.mark.parametrize("kind", ["PERSP", "PANO", "ORTHO"])
def test_no_point_of_a_sphere_shows_more_pixels_a_metre_than_it_is_said_to(kind):
    random = np.random.default_rng(2)
    eye = replace(CAMERA, kind=kind, origin=np.array([1.0, 2, 3]))
    points, radius = random.normal(scale=8, size=(3, 500)) + eye.origin[:, None], random.uniform(0.1, 1.5, 500)
    most = pixels_per_metre(points, radius, [eye])
    rays = random.normal(size=(2000, 3))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    seen, reached = 0, 0.0
    for i in range(500):
        x, y, z = ((points[:, i] + radius[i] * rays - eye.origin) @ axis for axis in (eye.X, eye.Y, eye.Z))
        if kind == "ORTHO":
            pixels = np.full(1, eye.pixels_per_unit)
        elif kind == "PANO":
            pixels = eye.pixels_per_unit / np.maximum(np.sqrt(x * x + y * y + z * z), eye.near)
        else:
            w = eye.window
            inside = (z > eye.near) & (x >= w.left * z) & (x <= w.right * z) & (y >= w.bottom * z) & (y <= w.top * z)
            pixels = eye.pixels_per_unit / z[inside]
        if len(pixels):
            seen += 1
            assert pixels.max() <= most[i] * (1 + 1e-6)
            reached = max(reached, pixels.max() / most[i])
    assert seen > 30 and reached > 0.9
    both = pixels_per_metre(points, radius, [eye, replace(eye, origin=np.zeros(3))])
    assert (both >= most).all() and (kind == "ORTHO" or (both > most).any())


def test_a_lod_is_blended_where_its_nearest_pose_is_too_far_off_and_gets_more_poses_where_that_is_still_too_far():
    motions = [of_curve(), of_curve(40.0), of_curve(), Motion(np.inf), Motion()]
    path = np.array([motion.path for motion in motions])
    pixels = np.where(np.isfinite(path), path, 1e9)[:, None] * np.array([400.0, 30.0, 1.0])
    counts = pose_counts(pixels, np.full((5, 3), 4000), 1.0)
    mixed = np.array([True, True, False, True, True])
    found, coarse, bent, off = blended(motions, pixels, counts, mixed, 1.0)
    assert (found[:, 0] == counts[:, 0]).all() and (found >= counts).all() and found[1, 1] > counts[1, 1]
    assert np.isinf(coarse[2:]).all()  # nothing lies between, or nothing moves
    far = pixels / found / 2 > 1.0
    np.testing.assert_array_equal(np.isfinite(coarse), far & np.array([1, 1, 0, 0, 0], bool)[:, None])
    assert off[0, 1] <= 1.0 < (pixels / counts / 2)[0, 1]
    # an agent that shows `coarse` pixels a metre, all of the way between two poses, is a pixel off
    np.testing.assert_allclose(coarse[0, 0] * path[0] / found[0, 0], 1.0)
    assert (bent[:2, 0] > 0).all() and (bent[2:] == 0).all()
    same, coarse, _, off = blended(motions, pixels, counts, mixed, None)  # who asks for no tolerance
    np.testing.assert_array_equal(same, counts)
    np.testing.assert_array_equal(off, pixels / counts / 2)
    assert np.isinf(coarse).all()


@pytest.mark.parametrize("count", [32, 64, 256])
def test_meshes_between_poses_are_as_few_as_the_tolerance_allows(count):
    random, motion, tolerance = np.random.default_rng(4), of_curve(), 0.8
    way, poses = curve(2**15), curve(count)
    counts = np.array([[count]])
    pixels = np.array([[3 * count]])  # the nearest pose is 1.5 pixels off where the LOD begins
    found, coarse, bent, off = blended([motion], pixels, counts, np.ones(1, bool), tolerance)
    assert found == counts and np.isfinite(coarse).all()
    index = random.integers(0, len(way), 20_000)
    phase, scale = index / len(way), random.uniform(0, 4, 20_000) * pixels[0, 0] / motion.path
    step, share = beside(phase, np.full(20_000, count), np.ones(20_000, bool))
    kept = rounded(share, scale, np.full(20_000, coarse[0, 0]), np.full(20_000, bent[0, 0]))
    nearest = np.rint(phase * count).astype(int) % count
    shown = poses[nearest] + kept[:, None] * (poses[(nearest + step) % count] - poses[nearest])
    error = scale * np.linalg.norm(shown - way[index], axis=1)
    known = scale * (share > 0) * chord(np.array([motion.bends]), counts)[0, 0]
    assert (error <= np.maximum(tolerance, 2 * known + tolerance / 4)).all()
    assert np.quantile(error, 0.9) < tolerance
    meshes = len(np.unique(np.stack([nearest, step, kept])[:, kept > 0], axis=1).T)
    assert count < meshes < 32 * count  # steps of 1/32 at the nearest, where an agent would be 7.5 tolerances off
    assert not kept[scale < coarse[0, 0]].any()


def test_agents_share_the_meshes_between_poses_and_the_first_of_each_makes_it():
    random = np.random.default_rng(1)
    pose, other = random.integers(0, 9, 500).astype(np.int32), random.integers(0, 9, 500).astype(np.int32)
    share = (random.integers(0, 5, 500) / 8).astype(np.float32)
    mixed, mixes = shared(pose, other, share)
    seen = []
    for each, number, first in zip(zip(pose, other, share, strict=True), mixed, mixes, strict=True):
        if not each[2]:
            assert not first
            continue
        assert first == (each not in seen)
        if first:
            seen.append(each)
        assert seen[number] == each
    assert len(seen) > 100
    nobody, none = shared(pose[:0], other[:0], share[:0])
    assert len(nobody) == len(none) == 0 and not shared(pose, other, 0 * share)[1].any()


def table(*speeds, edge="clamp"):
    """A state machine that walks at these speeds."""
    states = {f"s{i}": {"on": {"*": {"speed": speed, "heading": 90 * i}}} for i, speed in enumerate(speeds)}
    return parse(json.dumps({"version": 1, "edge": edge, "labels": {"ground": {"color": "#808080"}}, "states": states}), "test")


def test_an_action_has_a_rate_for_each_speed_if_it_plays_by_the_way_and_one_if_by_time():
    groups = (
        Group("a", 1, 1, stride=2.0, period=1.0),
        Group("b", 1, 1, stride=0.0, period=0.5),
        Group("c", 1, 1, stride=0.0, period=0.0),
    )
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
