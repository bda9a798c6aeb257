from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy, grain, limits
from crowd_lod_extension.crowd_lod.levels.texture_scale import halvings, scaled, texel

from ..support.cameras import straight

BYTES = np.arange(256) / 255
LIGHT = np.where(BYTES <= 0.04045, BYTES / 12.92, ((BYTES + 0.055) / 1.055) ** 2.4)


def square(width, height):
    """A rectangle of these meters, on which the whole of an image lies: corners and UVs of its
    triangles.
    """
    corners = np.array([[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], np.float64)
    return np.concatenate([corners * (width, height), np.zeros((2, 3, 1))], axis=2), corners


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
def test_texel_is_its_longest_side(turn):
    corners, uvs = square(3.0, 1.0)
    turned = uvs @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert texel(corners, turned, (100, 100)) == pytest.approx(0.03)
    assert texel(corners, uvs, (300, 50)) == pytest.approx(0.02)


def test_texel_heeds_all_but_a_twentieth_of_the_area():
    (near, uvs) = square(1.0, 1.0)
    (far, _) = square(10.0, 10.0)
    for count, expected in ((30, 0.1), (1, 0.1), (2500, 0.01)):
        corners = np.concatenate([near] * count + [far])
        assert texel(corners, np.concatenate([uvs] * (count + 1)), (100, 100)) == pytest.approx(
            expected
        )
    assert (
        texel(near, uvs * 0, (100, 100)) == np.inf
    )  # one texel is all that shows, as of a palette
    assert texel(near * 0, uvs, (100, 100)) == texel(near[:0], uvs[:0], (100, 100)) == np.inf


def test_images_are_halved_as_often_as_half_a_pixel_allows():
    for pixel in (0.001, 0.0199, 0.02, 0.05, 0.3):
        times = halvings(0.001, pixel, (4096, 4096))
        assert times == 0 or 0.001 * 2**times <= pixel / 2 < 0.001 * 2 ** (times + 1)
    assert halvings(np.inf, 1.0, (64, 64)) == 0
    assert halvings(1e-9, 1.0, (64, 16)) == 6  # to a single texel


def test_scaled_texels_are_the_mean_light_of_their_area():
    values = np.random.default_rng(1).integers(0, 256, (8, 12, 4)).astype(np.float32) / 255
    plain = scaled(values, 2, None, False)
    np.testing.assert_allclose(plain, values.reshape(2, 4, 3, 4, 4).mean(axis=(1, 3)), atol=1e-6)
    light = LIGHT[np.rint(values[..., :3] * 255).astype(int)]
    found = scaled(values, 2, LIGHT, False)
    np.testing.assert_allclose(
        found[..., :3], light.reshape(2, 4, 3, 4, 3).mean(axis=(1, 3)), atol=1e-6
    )
    np.testing.assert_allclose(found[..., 3], plain[..., 3])
    odd = scaled(values[:7, :5], 2, None, False)  # 2 x 2 texels of 3.5 x 2.5
    assert odd.shape == (2, 2, 4)
    np.testing.assert_allclose(odd.mean(axis=(0, 1)), values[:7, :5].mean(axis=(0, 1)), atol=1e-6)
    expected = (
        values[:3, :2].sum(axis=(0, 1))
        + values[3, :2].sum(axis=0) / 2
        + values[:3, 2].sum(axis=0) / 2
        + values[3, 2] / 4
    ) / 8.75
    np.testing.assert_allclose(odd[0, 0], expected, atol=1e-6)


def test_transparent_texels_lend_no_color():
    values = np.zeros((2, 2, 4), np.float32)
    values[0, 0] = (1.0, 0.5, 0.0, 1.0)
    values[1, 1] = (0.0, 1.0, 1.0, 0.0)
    np.testing.assert_allclose(
        scaled(values, 1, None, True)[0, 0], (1.0, 0.5, 0.0, 0.25), atol=1e-4
    )
    values[..., 3] = 0
    np.testing.assert_allclose(
        scaled(values, 1, None, True)[0, 0], (0.25, 0.375, 0.25, 0.0), atol=1e-4
    )


def test_grain_is_what_a_pixel_shows_of_the_nearest_agent():
    radius = np.array([1.0, 2.0])
    for camera, expected in (
        (straight(far=80.0), [[0.14, 0.78], [0.12, 0.76]]),  # 50 pixels a unit of slope
        (straight(80.0, "ORTHO"), [[0.1, 0.1]] * 2),
    ):
        begins = limits(LevelPolicy((0.1, 0.5)), camera, radius)
        np.testing.assert_allclose(grain(begins, camera, radius), expected)
    far = straight(far=80.0)
    assert grain(np.array([[np.inf]]), far, radius[:1]) == pytest.approx(
        1.58
    )  # of agents that nobody sees nearer
    deviation = np.array([[0, 0.05]])
    policy = LevelPolicy((0.0,), tolerance=2.0)
    for camera in (
        far,
        replace(far, pixels=(1000, 1000)),
    ):  # by tolerance it does not depend on the lens
        assert grain(
            limits(policy, camera, radius[:1], deviation), camera, radius[:1]
        ) == pytest.approx(0.025)
