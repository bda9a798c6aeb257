from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import (
    Stereo,
    frustum_corners,
    lens_blur,
    make_spherical,
    place_eye,
    referential,
    window,
)
from crowd_lod_extension.crowd_lod.culling.frustum import frustum_of
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.culling.shutter import open_shutter
from crowd_lod_extension.crowd_lod.errors import CrowdError

from ..support.cameras import ONE, straight, turned
from ..support.crowds import crowd_at
from ..support.culling_audit import LENSES, random_camera


def test_referential_of_a_scaled_sheared_mirrored_camera_is_blenders():
    random = np.random.default_rng(4)
    for _ in range(200):
        matrix = np.eye(4)
        matrix[:3, :3] = random.normal(size=(3, 3)) * 10.0 ** random.uniform(-6, 6)
        matrix[:3, 3] = random.normal(size=3)
        origin, X, Y, Z = referential(matrix)
        assert (origin == matrix[:3, 3]).all()
        # a point placed by camera coordinates along the normalized axes has these coordinates again
        x, y, z = random.normal(size=3)
        right, up, back = (matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)).T
        v = x * right + y * up - z * back
        np.testing.assert_allclose((v @ X, v @ Y, v @ Z), (x, y, z), atol=1e-9)


def test_referential_of_a_rotation_is_orthonormal():
    matrix = np.eye(4)
    matrix[:3, :3] = turned(np.random.default_rng(5)) * (2.0, 3.0, 0.1)
    _, *axes = referential(matrix)
    np.testing.assert_allclose(np.array(axes) @ np.array(axes).T, np.eye(3), atol=1e-12)


def test_straight_down_and_straight_up():
    down = np.eye(4)
    up = np.diag([1.0, -1, -1, 1])
    assert referential(down)[3].tolist() == [0, 0, -1]
    assert referential(up)[3].tolist() == [0, 0, 1]


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1, 0, 1]), np.full((4, 4), np.nan)])
def test_flat_or_nan_cameras_are_named(matrix):
    with pytest.raises(CrowdError, match="Camera.007"):
        referential(matrix, "Camera.007")


def test_window_by_hand():
    # 36 mm sensor, 18 mm lens, 200 x 100 pixels: 90 degrees wide, half as high
    w = window(36 / 18, "AUTO", (200, 100))
    assert (w.left, w.right, w.bottom, w.top) == (-1, 1, -0.5, 0.5)
    w = window(36 / 18, "AUTO", (100, 200), shift=(0.25, -0.5))  # the longer side is vertical
    assert (w.left, w.right, w.bottom, w.top) == (0, 1, -2, 0)
    w = window(2.0, "HORIZONTAL", (100, 100), aspect=(2, 1))
    assert (w.left, w.right, w.bottom, w.top) == (-1, 1, -0.5, 0.5)
    w = replace(straight(), pixels=(200, 100), filtered=10.0).visible_window
    assert (w.left, w.right, w.bottom, w.top) == (-1.1, 1.1, -1.2, 1.2)


def test_frustum_corners_lie_on_the_window():
    corners = frustum_corners(straight(), 10.0)
    assert sorted(map(tuple, corners)) == [
        (-10, 10, -10),
        (-10, 10, 10),
        (10, 10, -10),
        (10, 10, 10),
    ]


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "panoramic"])
def test_frustum_corners_lie_on_the_planes(lens):
    random = np.random.default_rng(6)
    for _ in range(50):
        camera = random_camera(random, lens)
        p = frustum_of(camera)
        v = frustum_corners(camera, camera.far) - camera.origin
        out = v @ p.normals[:4].T - p.offsets[:4]
        scale = np.abs(v).max()
        assert (np.sort(np.abs(out), axis=1)[:, :2] < 1e-9 * scale).all()  # each on two sides
        assert (out < 1e-9 * scale).all()


def test_depth_of_field_is_kept_where_its_rays_reach():
    # rays from a lens of radius 0.2 through points of the focal plane at 5 m, to 40 m; none may be
    # culled
    random = np.random.default_rng(8)
    blurred = lens_blur(straight(), 0.2, 5.0)
    lens = random.uniform(-0.2, 0.2, (5000, 2)) / np.sqrt(2)
    focus = random.uniform(-5, 5, (5000, 2))
    focus[:2500] = np.sign(focus[:2500]) * 5  # the corner rays
    depth = random.uniform(1, 40, 5000)
    at = lens + (focus - lens) * (depth / 5)[:, None]
    points = np.stack([at[:, 0], depth, at[:, 1]], axis=1)
    assert radar(crowd_at(points), blurred, ONE, np.zeros(1))[0].all()
    assert not radar(crowd_at(points), straight(), ONE, np.zeros(1))[0].all()


def between(a, b, part):
    """The matrix a fraction of the way from a to b, turning evenly about one axis."""
    turn = b[:3, :3] @ a[:3, :3].T
    angle = (
        np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) * part
        if np.abs(turn - np.eye(3)).max() > 1e-9
        else 0.0
    )
    if not angle:
        return a + (b - a) * part
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = a + (b - a) * part
    matrix[:3, :3] = (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross) @ a[
        :3, :3
    ]
    return matrix


@pytest.mark.parametrize(
    ("turns", "lens"), [(1, 0), (0, 1), (1, 1)], ids=["turns", "moves and zooms", "all at once"]
)
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "PANO"])
def test_open_shutter_sees_what_any_time_between_sees(kind, turns, lens):
    random = np.random.default_rng(9)
    seen_between = 0
    for _ in range(20):
        a = np.eye(4)
        b = np.eye(4)
        a[:3, :3] = turned(random)
        a[:3, 3] = b[:3, 3] = random.normal(size=3) * 5
        b[:3, 3] += lens * random.normal(size=3) * 5
        small = turned(random)
        b[:3, :3] = between(np.eye(4), np.pad(small, (0, 1)), 0.15 * turns)[:3, :3] @ a[:3, :3]
        size = 10.0 if kind == "ORTHO" else 0.5

        def at(part, a=a, b=b, size=size):
            base = straight(kind=kind, far=80.0)
            change = lens * part
            shape = window(size * (1 + 0.3 * change), "AUTO", (160, 90))
            axes = dict(
                zip(("origin", "X", "Y", "Z"), referential(between(a, b, part)), strict=True)
            )
            return replace(
                base,
                **axes,
                window=shape,
                near=1 + change,
                far=80 - 5 * change,
                cone=1 + 0.2 * change,
            )

        points = a[:3, 3] + random.uniform(-90, 90, (4000, 3))
        kept = np.zeros(len(points), bool)
        for camera in open_shutter([at(0.0), at(0.5), at(1.0)]):
            kept |= radar(crowd_at(points), camera, ONE, np.array([0.5]))[0]
        ends = radar(crowd_at(points), [at(0.0), at(0.5), at(1.0)], ONE, np.array([0.5]))[0]
        for part in random.uniform(0, 1, 12):
            now = radar(crowd_at(points), at(part), ONE, np.array([0.5]))[0]
            assert not (now & ~kept).any()
            seen_between += (now & ~ends).sum()
    assert seen_between > 0  # the samples alone would have missed some


def test_two_eyes_keep_what_either_sees():
    left = straight(offset=(-0.5, 0, 0))
    right = straight(offset=(0.5, 0, 0))
    points = np.random.default_rng(1).uniform(-30, 30, (3000, 3))
    each = [radar(crowd_at(points), camera, ONE, np.array([0.2])) for camera in (left, right)]
    visible, distance = radar(crowd_at(points), (left, right), ONE, np.array([0.2]))
    assert (visible == (each[0][0] | each[1][0])).all()
    assert (each[0][0] != each[1][0]).any()
    assert (distance == np.minimum(each[0][1], each[1][1])).all()


def test_off_axis_eyes_meet_at_the_convergence_distance():
    matrix = np.eye(4)
    stereo = Stereo("OFFAXIS", "CENTER", 0.4, 5.0)
    edges = []
    for side in ("left", "right"):
        moved, slope = place_eye(matrix, stereo, side)
        edges.append(moved[0, 3] + slope * 5.0)  # the middle of its image, 5 m ahead
    assert edges == pytest.approx([0, 0])


def test_spherical_stereo_keeps_every_ray_of_both_eyes():
    random = np.random.default_rng(3)
    stereo = Stereo("OFFAXIS", "CENTER", 1.0, 4.0)
    camera = make_spherical(straight(), stereo)
    way = np.stack(
        [random.uniform(-1, 1, 4000), np.ones(4000), random.uniform(-1, 1, 4000)], axis=1
    )
    far = random.uniform(2, 60, (4000, 1))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(way, (0, 0, 1))
    side *= 0.5 * random.choice([-1, 1], (4000, 1)) / np.linalg.norm(side, axis=1, keepdims=True)
    turned_in = 4.0 * way - side
    points = side + far * turned_in / np.linalg.norm(turned_in, axis=1, keepdims=True)
    assert radar(crowd_at(points), camera, ONE, np.zeros(1))[0].all()
    assert not radar(crowd_at(points), straight(), ONE, np.zeros(1))[0].all()
