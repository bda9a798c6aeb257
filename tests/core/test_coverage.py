"""How much of a picture a crowd covers, beside squares that are drawn at random places."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.culling.coverage import COVERS, MOST, covered_pixels

from ..support.cameras import straight


def seen_ahead(places):
    """Return a camera at the origin and `places` (m, 3) ahead of it: right, up, meters away."""
    camera = replace(straight(), window=Window(-1, 1, -9 / 16, 9 / 16), pixels=(320, 180))
    axes = np.array([camera.X, camera.Y, camera.Z])
    return camera, (np.asarray(places, float) @ axes).T


def test_an_agent_covers_its_part_of_the_square_about_its_sphere():
    camera, places = seen_ahead([(0, 0, 40)])
    square = (2 * camera.pixels_per_unit / 40) ** 2
    covered = covered_pixels(camera, places, np.ones(1))
    assert 0.9 * COVERS * square < covered < COVERS * square


def test_agents_hide_one_another_where_they_are_and_nowhere_else():
    apart = [(x, 0, 40) for x in np.linspace(-10, 10, 8)]
    camera, places = seen_ahead(apart)
    alone = covered_pixels(camera, places[:, :1], np.ones(1))
    assert covered_pixels(camera, places, np.ones(8)) == pytest.approx(8 * alone, rel=0.1)
    # a hundred in one place cover no more than the four cells, of ten pixels, that they meet
    camera, places = seen_ahead([(0, 0, 40)] * 100)
    assert 300 < covered_pixels(camera, places, np.ones(100)) <= 400


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "PANO"])
def test_a_crowd_covers_no_more_than_the_picture(kind):
    random = np.random.default_rng(3)
    camera, places = seen_ahead(random.uniform((-9, -9, -2), (9, 9, 30), (5000, 3)))
    camera = replace(camera, kind=kind)
    covered = covered_pixels(camera, places, np.full(5000, 0.9))
    assert 0.3 * 320 * 180 < covered <= 320 * 180


def test_some_far_agents_stand_for_all():
    """Three agents of a third of the size cover as much as one does, in a crowd of many."""
    random = np.random.default_rng(4)
    camera, places = seen_ahead(random.uniform((-90, -9, 100), (90, 0, 400), (MOST - 1, 3)))
    one = covered_pixels(camera, places, np.full(MOST - 1, 0.9))
    thrice = np.tile(places, 3)
    three = covered_pixels(camera, thrice, np.full(3 * (MOST - 1), 0.9 / np.sqrt(3)))
    assert three == pytest.approx(one, rel=0.06)


def test_nobody_covers_nothing_and_who_stands_beside_the_picture_neither():
    camera, places = seen_ahead([(500, 0, 40)])
    assert covered_pixels(camera, places, np.ones(1)) == 0
    assert covered_pixels(camera, places[:, :0], np.ones(0)) == 0
