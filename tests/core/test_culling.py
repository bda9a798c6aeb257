import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.camera import Camera, Window, referential, window
from crowd_lod_extension.crowd_lod.culling import BLOCK, radar

from .crowds import crowd_at
from .oracle import sees

ONE = np.array([0.0])


def turned(random):
    """A random rotation (3, 3)."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def random_camera(random, kind):
    matrix = np.eye(4)
    matrix[:3, :3] = turned(random)
    matrix[:3, 3] = random.normal(size=3) * 10.0 ** random.uniform(-1, 4)
    origin, X, Y, Z = referential(matrix)
    size = 10.0 ** random.uniform(-1.5, 1.5) if kind == "PERSP" else 10.0 ** random.uniform(0, 2)
    pixels = tuple(int(n) for n in random.integers(10, 4000, size=2))
    fit = random.choice(["AUTO", "HORIZONTAL", "VERTICAL"])
    shape = window(size, fit, pixels, tuple(random.uniform(0.5, 2, 2)), tuple(random.uniform(-1, 1, 2)))
    near = 10.0 ** random.uniform(-2, 0)
    return Camera(kind, origin, X, Y, Z, shape, near, near + 10.0 ** random.uniform(0.5, 3), pixels)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_against_exact_planes(kind):
    random = np.random.default_rng(11)
    missed = surplus = kept = 0
    for _ in range(120):
        camera = random_camera(random, kind)
        depth = random.uniform(-0.2, 1.2, 80) * camera.far
        scale = np.abs(depth) if kind == "PERSP" else np.ones(80)
        w = camera.window
        right = random.uniform(1.5 * w.left - 0.5 * w.right, 1.5 * w.right - 0.5 * w.left, 80) * scale
        up = random.uniform(1.5 * w.bottom - 0.5 * w.top, 1.5 * w.top - 0.5 * w.bottom, 80) * scale
        points = camera.origin + right[:, None] * camera.X + up[:, None] * camera.Y + depth[:, None] * camera.Z
        radius = 10.0 ** random.uniform(-3, 1.5)
        visible, _ = radar(crowd_at(points), camera, ONE, np.array([radius]))
        exact = np.array([sees(camera, p, radius) for p in points])
        missed += int((exact & ~visible).sum())
        surplus += int((visible & ~exact).sum())
        kept += int(visible.sum())
    assert kept > 1000  # the oracle had something to say
    assert missed == 0
    assert surplus <= 0.001 * kept


def straight(far=100.0, kind="PERSP", offset=(0.0, 0.0, 0.0)):
    """A camera at `offset` that looks along +y, 90 degrees wide and high."""
    X, Y, Z = np.eye(3)[[0, 2, 1]]
    half = 1.0 if kind == "PERSP" else 5.0
    return Camera(kind, np.array(offset, float), X, Y, Z, Window(-half, half, -half, half), 1.0, far, (100, 100))


def test_agents_exactly_on_planes_are_visible():
    # exactly representable: unit sphere on the near, far and side planes of a camera 90 degrees wide
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
    visible, _ = radar(crowd_at(points), straight(), ONE, np.array([50.0]), margin=3.0)
    assert visible.tolist() == [True, False, False, False, True]


def test_panoramic_camera_keeps_all_within_range():
    points = [(0, -50, 0), (50, 0, 0), (0, 0, -99), (0, 102, 0), (0.1, 0.1, 0)]
    visible, distance = radar(crowd_at(points), straight(kind="PANO"), ONE, np.array([0.5]))
    assert visible.tolist() == [True, True, True, False, False]
    np.testing.assert_allclose(distance, np.linalg.norm(points, axis=1))


@pytest.mark.parametrize("offset", [1e4, 1e6, 1e8])
def test_far_from_the_world_origin_nothing_is_missed(offset):
    random = np.random.default_rng(2)
    camera = straight(offset=(offset, -offset, offset))
    points = camera.origin + random.uniform(-60, 120, (3000, 3))
    visible, _ = radar(crowd_at(points), camera, ONE, np.array([0.5]))
    exact = np.array([sees(camera, p, 0.5) for p in points])
    assert not (exact & ~visible).any()
    assert (visible & ~exact).sum() <= 0.001 * visible.sum()


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 7])
def test_blocks_agree_with_one_agent_at_a_time(count):
    random = np.random.default_rng(count)
    points = random.uniform(-100, 100, (count, 3))
    groups = random.integers(2, size=count)
    centre, radius = np.array([0.5, 1.5]), np.array([0.7, 4.0])
    visible, distance = radar(crowd_at(points, groups), straight(), centre, radius)
    assert len(visible) == len(distance) == count
    for i in range(0, count, 997):
        one, at = radar(crowd_at(points[i], groups[i : i + 1]), straight(), centre, radius)
        assert one[0] == visible[i] and at[0] == distance[i]
