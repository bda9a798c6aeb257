"""Shaded pictures of a body, and how alike two are: against the formula of Lambert and sums pixel
by pixel.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.levels.assignment import (
    LevelPolicy,
    deviations,
    threshold_distances,
)
from crowd_lod_extension.crowd_lod.validation import shaded_pictures
from crowd_lod_extension.crowd_lod.validation.shaded_pictures import ShadedMesh, likeness, pictures

from ..support.bodies import ball
from ..support.cameras import straight

NONE = np.empty((0, 1, 1, 4), np.uint8)
AXES = np.eye(3)[[0, 2, 1]] * [[1], [1], [-1]]  # seen from -y, z up


def body(points, triangles, color=(0.8, 0.4, 0.2), uvs=None, image=-1):
    m = len(triangles)
    uvs = np.zeros((m, 3, 2)) if uvs is None else uvs
    return ShadedMesh(
        points, triangles, points[triangles], uvs, np.tile(color, (m, 3, 1)), np.full(m, image)
    )


def flat(points, pixels):
    return points @ AXES.T * (pixels, pixels, -pixels)


def linear(encoded):
    return np.where(encoded < 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_a_ball_is_lit_as_lambert_says():
    points, triangles = ball(96, 47)
    (picture,) = pictures([body(points, triangles)], NONE, [flat(points, 60)], AXES)
    rows, columns = picture.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    low = flat(points, 60)[:, :2].min(axis=0) - shaded_pictures.MARGIN
    across = (x + 0.5 + low[0]) / 60
    up = (y + 0.5 + low[1]) / 60
    inside = across**2 + up**2 < 0.9
    towards = np.sqrt(1 - (across**2 + up**2)[inside])
    lit = np.clip(
        np.stack([across[inside], up[inside], towards], axis=1) @ shaded_pictures.LIGHT, 0, 1
    )
    wanted = np.outer(shaded_pictures.SKY + (1 - shaded_pictures.SKY) * lit, (0.8, 0.4, 0.2))
    assert np.abs(linear(picture[inside]) - wanted).max() < 0.02
    assert np.abs(linear(picture[across**2 + up**2 > 1.1]) - shaded_pictures.PAPER).max() < 1e-9


def test_an_image_takes_the_place_of_the_color():
    """A square whose image is red on the left and blue on the right, seen from in front."""
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1.0)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    image = np.zeros((1, 4, 4, 4), np.uint8)
    image[0, :, :2, 0] = 255
    image[0, :, 2:, 2] = 255
    square = body(points, triangles, uvs=points[triangles][..., [0, 2]], image=0)
    square = ShadedMesh(**{**vars(square), "normals": np.broadcast_to((0.0, -1.0, 0.0), (2, 3, 3))})
    (picture,) = pictures([square], image, [flat(points, 40)], AXES)
    left = picture[20, shaded_pictures.MARGIN + 8]
    right = picture[20, shaded_pictures.MARGIN + 32]
    assert left[0] > 0.5 > left[2] + 0.4 and right[2] > 0.5 > right[0] + 0.4


def test_what_is_nearer_hides_what_is_behind():
    points, triangles = ball(24, 11)
    far = points + (0, 3, 0)
    near = points
    both = np.concatenate([far, near])
    normals = np.concatenate([points[triangles], points[triangles]])
    count = len(triangles)
    two = ShadedMesh(
        both,
        np.concatenate([triangles, triangles + len(points)]),
        normals,
        np.zeros((2 * count, 3, 2)),
        np.repeat([[(1.0, 0, 0)] * 3, [(0, 1.0, 0)] * 3], count, axis=0),
        np.full(2 * count, -1),
    )
    (picture,) = pictures([two], NONE, [flat(both, 30)], AXES)
    middle = picture[picture.shape[0] // 2, picture.shape[1] // 2]
    assert middle[1] > 0.5 and middle[0] < 0.01


def test_likeness_is_what_sums_pixel_by_pixel_give():
    random = np.random.default_rng(0)
    one = np.full((24, 30, 3), 0.4)
    one[7:17, 8:22] = random.random((10, 14, 3))
    other = one.copy()
    other[7:17, 8:22] = (one[7:17, 8:22] + 0.3 * random.random((10, 14, 3))).clip(0, 1)
    gray = [picture @ (0.2126, 0.7152, 0.0722) for picture in (one, other)]
    weight = np.exp(-(np.arange(-5, 6)[:, None] ** 2 + np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weight /= weight.sum()
    values = []
    gaps = []
    for row in range(7, 17):
        for column in range(8, 22):
            a, b = (g[row - 5 : row + 6, column - 5 : column + 6] for g in gray)
            u = (weight * a).sum()
            v = (weight * b).sum()
            s = (weight * (a - u) ** 2).sum()
            t = (weight * (b - v) ** 2).sum()
            c = (weight * (a - u) * (b - v)).sum()
            values.append(
                (2 * u * v + 1e-4) * (2 * c + 9e-4) / ((u * u + v * v + 1e-4) * (s + t + 9e-4))
            )
            gaps.append(np.abs(one[row, column] - other[row, column]).mean())
    assert likeness(one, other) == pytest.approx((np.mean(gaps), np.mean(values)), abs=1e-9)
    assert likeness(one, one) == pytest.approx((0, 1)) and likeness(one[:3], one[:3]) == (0.0, 1.0)


def test_a_thinner_ball_and_one_lit_otherwise_are_less_alike():
    points, triangles = ball(48, 23)
    whole = body(points, triangles)
    found = []
    for other, shown in (
        (whole, points),
        (body(0.95 * points, triangles), 0.95 * points),
        (body(0.8 * points, triangles), 0.8 * points),
        (ShadedMesh(**{**vars(whole), "normals": np.roll(whole.normals, 1, axis=2)}), points),
    ):
        found.append(
            likeness(*pictures([whole, other], NONE, [flat(points, 40), flat(shown, 40)], AXES))
        )
    differences, alike = np.array(found).T
    assert differences[0] == 0 and alike[0] == pytest.approx(1)
    assert differences[1] < differences[2] and alike[1] > alike[2]
    assert differences[3] > 0.05 and alike[3] < 0.99


def on_paper(values):
    """A picture of 100 x 90 pixels, of which a square of 32 x 32 shows these linear values."""
    picture = np.full((100, 90, 4), shaded_pictures.PAPER)
    picture[..., 3] = 0.0
    picture[32:64, 20:52, :3] = values
    picture[32:64, 20:52, 3] = 1.0
    return picture


def test_what_differs_in_detail_alone_is_alike_from_afar():
    """Squares of 8 pixels, and the same the other way round: no color of a block is found in the
    other picture, and of the means of 16 x 16 each is.
    """
    rows, columns = np.mgrid[:32, :32] // 8
    first = (rows + columns) % 2 == 0
    one, other = (on_paper(np.where(each, 0.6, 0.4)[..., None]) for each in (first, ~first))
    differences = shaded_pictures.from_afar(one, other)
    encoded = 1.055 * np.array([0.6, 0.4]) ** (1 / 2.4) - 0.055
    assert len(differences) == shaded_pictures.HALVINGS + 1
    # but for the sides of a square that have another beside them, which finds its color there; of
    # a corner of all two have none
    assert differences[0] == pytest.approx((7 / 8) ** 2 * (encoded[0] - encoded[1]))
    np.testing.assert_allclose(differences[4:], 0, atol=1e-12)
    brighter = shaded_pictures.from_afar(one, on_paper(0.6))  # in the mean, too
    assert max(brighter[1:5]) > 0.01 and brighter[-1] < brighter[1]


def test_outlines_and_what_is_moved_by_a_pixel_do_not_count():
    stripes = np.where(np.arange(2, 36) // 4 % 2, 0.6, 0.1)[:, None, None] * np.ones((1, 32, 3))
    one, other = on_paper(stripes[:32]), on_paper(stripes[1:33])
    assert shaded_pictures.from_afar(one, other)[0] == 0
    assert shaded_pictures.from_afar(one, np.roll(one, 1, axis=0))[0] == 0
    thinner = one.copy()
    thinner[32:64, 44:52] = on_paper(0.0)[0, 0]
    assert shaded_pictures.from_afar(one, thinner)[0] == 0


def test_one_lost_patch_is_found_wherever_it_lies():
    for row in range(32, 44):
        spoilt = on_paper(0.5)
        spoilt[row : row + 12, 30:42, :3] = 0.05
        (most, *_) = shaded_pictures.from_afar(on_paper(0.5), spoilt)
        assert most == pytest.approx(0.7354 - 0.2475, abs=1e-3)


def test_a_lod_begins_where_its_outline_and_its_colors_allow():
    group = Group(
        "a",
        1.0,
        1.0,
        0.0,
        0.0,
        bounds=(0, 0.01, 0.02, 0.1),
        deviations=(0,) * 4,
        shaded=(0, 0.05, 0.0, np.inf),
    )
    for tolerance in (1.0, 2.0):
        policy = LevelPolicy((0.0,) * 3, tolerance=tolerance)
        colorless = deviations([replace(group, shaded=())], policy)
        np.testing.assert_array_equal(colorless, [group.bounds])
        camera = straight()  # 50 pixels a unit of slope
        begin = threshold_distances(policy, camera, np.ones(1), deviations([group], policy))
        np.testing.assert_allclose(
            begin, [[max(50 * 0.01 / tolerance, 50 * 0.05) + 1] * 2 + [np.inf]]
        )
        assert threshold_distances(
            policy, straight(kind="ORTHO"), np.ones(1), deviations([group], policy)
        ).tolist() == [[-np.inf, -np.inf, np.inf]]
    by_distance = LevelPolicy((0.2, 0.4, 0.8))
    np.testing.assert_array_equal(deviations([group], by_distance), [group.bounds])
