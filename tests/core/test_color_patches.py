"""Colors are compared in patches: edges that move a little count for nothing, shadows count."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.validation.color_patches import BLOCK, compare

ROWS, COLUMNS = 61, 93  # no multiples of a block


def picture(edge=40, value=0.5):
    """A bright half beside a dark one."""
    pixels = np.full((ROWS, COLUMNS, 4), 0.1, np.float32)
    pixels[:, edge:, :3] = value
    return pixels


NOTHING = np.zeros((ROWS, COLUMNS), bool)


@pytest.mark.parametrize("by, wrong", [(0, 0), (1, 0), (2, 0), (7, 1)])
def test_an_edge_that_lies_within_the_tolerance_is_no_patch(by, wrong):
    _, largest, patches = compare(picture(), picture(40 + by), 2.0, NOTHING)
    assert len(patches) == wrong and (largest == 0) == (by <= 2)


def test_a_patch_says_where_it_is_and_whether_it_is_brighter():
    darker, brighter = picture(), picture()
    darker[8:24, 48:80, :3] = 0.2
    brighter[ROWS - 5 :, COLUMNS - 5 :, :3] = 1.0
    (patch,) = compare(picture(), darker, 1.0, NOTHING)[2]
    assert patch.box == (8, 24, 48, 80) and patch.off > 0.2 > 0 > patch.brighter
    (patch,) = compare(picture(), brighter, 1.0, NOTHING)[2]
    assert patch.box == (56, ROWS, 88, COLUMNS) and patch.brighter > 0.2
    both = np.where(brighter > 0.9, brighter, darker)
    worst, other = compare(picture(), both, 1.0, NOTHING)[2]
    assert worst.off > other.off
    off, largest, patches = compare(picture(), both, 1.0, ~NOTHING)
    assert not off.any() and largest == 0 and not patches


def test_it_is_the_same_both_ways_and_noise_is_no_patch():
    random = np.random.default_rng(1)
    noisy = picture() + random.normal(0, 0.02, (ROWS, COLUMNS, 1)).astype(np.float32)
    there, back = (
        compare(*pair, 1.0, NOTHING) for pair in ((picture(), noisy), (noisy, picture()))
    )
    assert there[1] == pytest.approx(back[1]) and not there[2] and not back[2]
    lonely = picture()
    lonely[::BLOCK, ::BLOCK, :3] = 1.0  # a pixel of each block
    assert not compare(picture(), lonely, 1.0, NOTHING)[2]
