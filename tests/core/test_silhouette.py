"""The rasterizer and the silhouette error, against areas, brute force and known outlines."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.simplification import rasterizer
from crowd_lod_extension.crowd_lod.validation import silhouette

from ..support.bodies import ball
from ..support.cameras import straight

pytestmark = pytest.mark.once


def test_a_mask_is_the_triangle_s_pixels_by_half_planes():
    random = np.random.default_rng(1)
    corners = random.uniform(-10, 50, (6, 3, 2))
    shape = (30, 40)
    column, row = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    expected = np.zeros(shape, bool)
    for a, b, c in corners:
        sides = [
            (q[0] - p[0]) * (row - p[1]) - (q[1] - p[1]) * (column - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        alone = np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)
        assert (silhouette.mask(np.array([[a, b, c]]), shape) == alone).all()
        expected |= alone
    assert (silhouette.mask(corners, shape) == expected).all() and 0.2 < expected.mean() < 1


@pytest.mark.parametrize("seed", range(8))
def test_a_mask_has_no_holes_where_centers_lie_on_edges(seed):
    """Corners on whole and half pixels, slivers, and triangles seen edge on: the pixels that
    `cover` finds one by one.
    """
    random = np.random.default_rng(seed)
    corners = random.integers(-20, 100, (40, 3, 2)) / 2
    corners[::4, 2] = corners[::4, 1] + 0.3 * (corners[::4, 0] - corners[::4, 1])
    one_by_one = np.zeros((30, 40), bool)
    for pixel, _, _ in rasterizer.cover(corners, one_by_one.shape):
        one_by_one.ravel()[pixel] = True
    assert (silhouette.mask(corners, one_by_one.shape) == one_by_one).all() and one_by_one.any()


def test_what_is_seen_is_the_nearest_triangle_with_its_weights():
    """Of so many pixels and triangles that they are looked at in parts."""
    random = np.random.default_rng(2)
    corners = random.uniform(0, 240, (50, 3, 2))
    depth = random.uniform(1, 9, (50, 3))
    shape = (240, 240)
    assert len(list(rasterizer.cover(corners, shape))) > 1
    pixel, triangle, weights = rasterizer.nearest(corners, depth, shape)
    assert len(np.unique(pixel)) == len(pixel) == silhouette.mask(corners, shape).sum()
    at = np.einsum("kc,kcd->kd", weights, corners[triangle])
    np.testing.assert_allclose(at, np.stack([pixel % 240, pixel // 240], 1) + 0.5, atol=1e-9)
    seen = (weights * depth[triangle]).sum(axis=1)
    for other in range(50):  # each triangle's own plane lies behind, wherever it covers
        own_pixel, _, own_weights = rasterizer.nearest(corners[[other]], depth[[other]], shape)
        place = np.searchsorted(pixel, own_pixel)
        assert (own_weights @ depth[other] >= seen[place] - 1e-9).all()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_outside_lies_as_far_from_the_other_area_as_by_brute_force(seed):
    random = np.random.default_rng(seed)
    one, other = (silhouette.mask(random.uniform(0, 40, (3, 3, 2)), (40, 50)) for _ in range(2))
    a = np.argwhere(one)
    b = np.argwhere(other)
    apart = np.linalg.norm(a[:, None] - b[None], axis=2)
    nearest = apart.min(axis=1)
    row, column, away = silhouette.outside(one, other)
    assert np.array_equal(np.stack([row, column], axis=1), a[nearest > 0])
    assert away == pytest.approx(nearest[nearest > 0])
    near = silhouette.outside(one, other, 3)[2]
    assert (near[away <= 3] == away[away <= 3]).all() and (near[away > 3] > 3).all()
    assert not len(silhouette.outside(one, one)[2])
    assert (silhouette.outside(one, np.zeros_like(one))[2] == np.inf).all()


@pytest.mark.once
@pytest.mark.parametrize("kind, distance", [("PERSP", 5.0), ("ORTHO", 8.0)])
def test_a_smaller_ball_s_outline_lies_inside_by_what_optics_says(kind, distance):
    camera = replace(straight(kind=kind), pixels=(400, 400))
    large = ball(63, 30)
    small = ball(63, 30, 0.9)
    unit = camera.pixels_per_unit
    # the outline of a sphere of radius r: the cone of half angle asin(r / d)
    seen = [unit * (r if kind == "ORTHO" else r / np.sqrt(distance**2 - r * r)) for r in (1.0, 0.9)]
    center = np.array([5.0, -3.0, 1.0])
    pair = [(points + center, triangles) for points, triangles in (large, small)]
    off = seen[0] - seen[1]
    least, most = silhouette.error(*pair, center, distance, camera, off)
    assert least <= off <= most and most - least <= max(0.3 * off, 0.3)
    assert silhouette.error(large, large, np.zeros(3), distance, camera) == (0, 0)


@pytest.mark.parametrize("expected", [0.05, 2.0])
def test_a_small_error_is_measured_finer_and_a_large_one_coarser(expected):
    large = ball(63, 30)
    camera = replace(straight(), pixels=(2000, 2000))
    away = 1000 * 0.02 / expected
    least, most = silhouette.error(large, ball(63, 30, 0.98), np.zeros(3), away, camera, expected)
    assert least <= 1000 / np.sqrt(away**2 - 1) - 980 / np.sqrt(away**2 - 0.98**2) <= most


@pytest.mark.parametrize("size", [0.04, 1.0, 30.0])
def test_a_tooth_is_measured_closer_than_the_masks_are_fine(size):
    """A square whose side one has a tooth `size` pixels long.

    The camera is so near that masks are no finer than four a pixel.
    """
    camera = replace(straight(kind="ORTHO"), pixels=(2000, 2000))
    unit = camera.pixels_per_unit
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], float) * 300 / unit
    tooth = np.array([(0, 300, -20), (0, 300 + size, 0), (0, 300, 20)], float) / unit
    quad = np.array([(0, 1, 2), (0, 2, 3)])
    least, most = silhouette.error(
        (np.concatenate([square, tooth]), np.concatenate([quad, [(4, 5, 6)]])),
        (square, quad),
        np.zeros(3),
        10.0,
        camera,
        size,
    )
    assert least <= size <= most and most - least < 0.2 * max(size, 1.0)


def test_directions_go_all_around_and_some_look_down():
    found = silhouette.directions()
    assert len(found) >= 12 and np.allclose(np.linalg.norm(found, axis=1), 1)
    assert (found[:8, 2] == 0).all() and (found[8:, 2] > 0.4).all()
    angles = np.sort(np.degrees(np.arctan2(found[:8, 1], found[:8, 0])) % 360)
    assert np.allclose(np.diff(angles), 45)


def test_a_sheet_seen_edge_on_is_off_by_no_more_than_it_deviates():
    """As wings, hair cards and cloth: one lies in the direction of a view, the other is tilted by 1
    cm a meter.
    """
    camera = replace(straight(), pixels=(2000, 2000))
    flat = np.array([(0, -1, -0.1), (0, 1, -0.1), (0, 1, 0.1), (0, -1, 0.1)], float)
    tilted = flat + flat[:, [1]] * (0.01, 0, 0)
    quad = np.array([(0, 1, 2), (0, 2, 3)])
    least, most = silhouette.error((flat, quad), (tilted, quad), np.zeros(3), 5.0, camera)
    assert least <= 0.01 * camera.pixels_per_unit / 4.0 and 0 < most
