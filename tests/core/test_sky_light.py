import numpy as np
import pytest
from crowd_lod_extension.crowd_lod import srgb
from crowd_lod_extension.crowd_lod.validation.sky_light import MOST_SHARE, changed_share

GRAY = np.full((92, 161, 3), 0.2)


def changed(steps, rows=slice(None)):
    """The gray picture, whose `rows` are so many 255ths lighter as they are shown."""
    picture = GRAY.copy()
    picture[rows] = srgb.linear(srgb.encoded(GRAY[rows]) + steps / 255)
    return picture


@pytest.mark.parametrize("steps", [1.1, -1.1, 20.0])
def test_what_changes_counts_by_its_part_of_the_picture(steps):
    share = changed_share(GRAY, changed(steps, slice(0, 24)))
    assert share == pytest.approx(3 / 11) and share > MOST_SHARE


def test_less_than_a_step_does_not_count():
    assert changed_share(GRAY, changed(0.9)) == 0


def test_one_color_channel_is_enough():
    picture = GRAY.copy()
    picture[..., 2] = changed(1.1)[..., 2]
    assert changed_share(GRAY, picture) == 1


def test_the_noise_of_single_rays_does_not_count_and_a_change_beneath_it_does():
    random = np.random.default_rng(0)
    noise = random.normal(0, 0.006, GRAY.shape)  # some two and a half steps
    assert changed_share(GRAY, GRAY + noise) == 0
    assert changed_share(GRAY, changed(1.6) + noise) == 1


def test_light_beyond_white_shows_no_change():
    assert changed_share(GRAY + 1, GRAY + 2) == 0
