from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.planning.frame import plan
from crowd_lod_extension.crowd_lod.validation.image_difference import FARTHEST, between, predicted, shift

from ..support.cameras import straight
from ..support.frames import shot


def disc(x, y, radius, size=(90, 120), samples=8):
    """Coverage of each pixel by a disc, from samples x samples of it."""
    rows, columns = ((np.arange(n * samples) + 0.5) / samples for n in size)
    inside = np.hypot(columns[None] - x, rows[:, None] - y) <= radius
    return inside.reshape(size[0], samples, size[1], samples).mean(axis=(1, 3))


def test_the_difference_is_counted_pixel_by_pixel():
    a = np.zeros((4, 5, 4), np.float32)
    b = a.copy()
    b[1, 2, 0], b[3, 3, 1], b[0, 0, 2] = 0.5, 1e-6, np.nan
    found = between(a, b)
    assert (found.pixels, found.visible, found.share) == (3, 2, 0.1)
    assert found.largest == pytest.approx(3.4e38, rel=0.01)
    c = a.copy()
    c[1, 2, 0] = 0.5
    found = vars(between(a, c))
    assert found.pop("rms") == pytest.approx(0.5 / 80**0.5)
    assert found == {"pixels": 1, "visible": 1, "share": 0.05, "largest": 0.5, "mean": 0.5 / 80}
    same = np.where(np.isnan(b), np.float32(np.inf), b)
    assert vars(between(same, same.copy())) == {"pixels": 0, "visible": 0, "share": 0.0, "largest": 0.0, "mean": 0.0, "rms": 0.0}
    assert between(b, b.copy()).pixels == 0


@pytest.mark.parametrize("way", [(0.0, 0.0), (0.4, 0.0), (3.0, 0.0), (0.0, -6.5), (5.0, 4.0), (-20.0, 8.0)])
def test_a_disc_that_moves_shifts_by_as_much(way):
    found = shift(disc(50, 45, 14), disc(50 + way[0], 45 + way[1], 14))
    assert abs(found - np.hypot(*way)) <= 1


def test_a_disc_that_grows_shifts_by_as_much_and_one_that_is_gone_by_the_most():
    for more in (0.5, 2, 7):
        assert abs(shift(disc(50, 45, 14), disc(50, 45, 14 + more)) - more) <= 1
        assert shift(disc(50, 45, 14), disc(50, 45, 14 + more)) == shift(disc(50, 45, 14 + more), disc(50, 45, 14))
    assert shift(disc(50, 45, 14), np.zeros((90, 120))) == FARTHEST
    assert shift(np.zeros((90, 120)), np.zeros((90, 120))) == 0


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_no_point_off_by_its_lods_deviation_lies_off_by_more_pixels_than_predicted(kind):
    random = np.random.default_rng(3)
    trajectory, camera = shot(), straight(kind=kind)
    groups = tuple(
        replace(group, deviations=off) for group, off in zip(trajectory.groups, ((0, 0.1, 0.4), (0, 0.05, 1.5)), strict=True)
    )
    bare, frame = (
        plan(each, camera, LevelPolicy((0.3, 0.6)), 20) for each in (trajectory, replace(trajectory, groups=groups, _kept={}))
    )
    agents = np.repeat(frame.buckets.order, 300)
    crowd, group = frame.crowd, frame.crowd.group[agents]
    way = random.normal(size=(2, len(agents), 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    center = np.stack([crowd.x[agents], crowd.y[agents], crowd.z[agents] + 0.9], axis=1)
    off = np.array([groups[g].deviations[k] for g, k in zip(group, frame.levels[agents], strict=True)])
    points = center + way[0] * random.random((len(agents), 1))  # in spheres of the radius 1
    there = points + way[1] * off[:, None]
    both = [each[:, ::2] / (each[:, 1:2] if kind == "PERSP" else 1.0) * camera.pixels_per_unit for each in (points, there)]
    inside = (np.abs(both[0]) <= 50).all(axis=1)  # the picture has 100 x 100 pixels
    pixels = np.linalg.norm(both[1] - both[0], axis=1)[inside]
    bound = predicted(frame)
    assert 0.4 * bound < pixels.max() <= bound
    assert predicted(bare) is None
    assert predicted(replace(frame, eyes=(straight(kind="PANO"),))) is None
