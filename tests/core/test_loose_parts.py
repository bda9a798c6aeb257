"""Loose parts do not starve the body that they are on, and show as much as before."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.simplification.decimate import decimate
from crowd_lod_extension.crowd_lod.simplification.loose_parts import silhouette_areas
from crowd_lod_extension.crowd_lod.simplification.pose_deformation import Skin, frames_of

from ..support.bodies import drum

pytestmark = pytest.mark.once

pytest.importorskip("fast_simplification")


def toothy(count=60):
    """A body of 1 m with a tail of 0.5 m, and loose teeth of 30 mm at its front."""
    body, faces = drum(16, 60)
    along = (body[:, 2] - body[:, 2].min()) / np.ptp(body[:, 2])
    width = np.where(
        along < 1 / 3,
        0.02 + 0.1 * along,
        np.sqrt(np.maximum(1 - (3 * along - 2) ** 2, 0.06)) * 0.25,
    )
    points = [np.column_stack([body[:, :2] * width[:, None], 1.5 * along])]
    triangles = [faces]
    tooth, faces = drum(8, 4)
    tooth = tooth / np.ptp(tooth, axis=0) * (0.012, 0.012, 0.03)
    for k in range(count):
        turn = k * 2.4
        points.append(tooth + (0.2 * np.cos(turn), 0.2 * np.sin(turn), 1.1 + 0.2 * k / count))
        triangles.append(faces + sum(map(len, points[:-1])))
    return np.concatenate(points), np.concatenate(triangles)


def swung(points, triangles):
    """The skin of a tail that swings to one side."""
    place = points.copy()
    place[:, 0] += np.maximum(0.5 - points[:, 2], 0) ** 2
    place = place[None]
    return Skin(points, place, frames_of(points, place, triangles))


@pytest.mark.parametrize("moves", [False, True])
def test_a_tail_stays_beside_more_teeth_than_there_are_triangles_for(moves):
    points, triangles = toothy()
    skin = swung(points, triangles) if moves else None
    lod = decimate(Mesh(points, triangles), 150 / len(triangles), "toothy", skin=skin, effort=0.2)
    assert 100 < len(lod.triangles) <= 150
    tip = points[points[:, 2].argmin()]
    assert np.linalg.norm(lod.points - tip, axis=1).min() < 0.06
    assert (lod.source < len(drum(16, 60)[0])).sum() > 15


def test_copies_of_a_body_in_one_place_both_stay():
    body, faces = drum(16, 20)
    points = np.concatenate([body, body])
    triangles = np.concatenate([faces, faces[:, ::-1] + len(body)])
    lod = decimate(Mesh(points, triangles), 0.1, "doubled", effort=0.1)
    assert len(np.unique(lod.source // len(body))) == 2


def robot(count=60):
    """Drums, boxes, rods and plates of all sizes, turned anyhow, along a body of 1.8 m."""
    random = np.random.default_rng(3)
    points = []
    triangles = []
    total = 0
    for k in range(count):
        own, faces = drum(*((16, 4), (4, 3), (12, 4), (20, 3))[k % 4])
        size = ((0.05, 0.05, 0.06), (0.07, 0.07, 0.05), (0.012, 0.012, 0.12), (0.09, 0.09, 0.01))[
            k % 4
        ]
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        own = own * size * np.exp(random.uniform(-1.2, 1.1))
        points.append(own @ turn.T + random.uniform((-0.6, -0.6, 0), (0.6, 0.6, 1.8)))
        triangles.append(faces + total)
        total += len(own)
    return np.concatenate(points), np.concatenate(triangles)


def count_covered(points, triangles, samples):
    """How many of samples (k, 2), seen along four directions, some triangle covers: by the signs of
    its sides, all tried.
    """
    found = 0
    for seed in range(4):
        axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0][:2]
        corners = ((points - (0, 0, 0.9)) @ axes.T)[triangles]
        sides = np.roll(corners, -1, axis=1) - corners
        for x, y in samples:
            turns = sides[..., 0] * (y - corners[..., 1]) - sides[..., 1] * (x - corners[..., 0])
            found += bool(((turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)).any())
    return found


@pytest.mark.parametrize("ratio", [0.06, 0.03])
def test_a_robot_of_many_parts_shows_as_much(ratio):
    points, triangles = robot()
    lod = decimate(Mesh(points, triangles), ratio, "robot")
    assert len(lod.triangles) <= round(ratio * len(triangles))
    samples = np.random.default_rng(0).uniform(-1, 1, (2_000, 2))
    assert count_covered(lod.points, lod.triangles, samples) == pytest.approx(
        count_covered(points, triangles, samples), rel=0.05
    )


def test_the_area_that_parts_show_is_that_of_their_shapes():
    """A ball shows pi r^2 from everywhere.

    A plate of area a, seen from the four corners of a cube, a / sqrt(3).
    """
    ball, faces = drum(48, 25)
    up = ball[:, 2:] * np.pi / 2
    ball = np.concatenate([np.cos(up) * ball[:, :2], np.sin(up)], axis=1)
    ball[-2:, :2] = 0
    plate = np.array([(5, 5, 0), (8, 5, 0), (8, 9, 0), (5, 9, 0.0)])
    triangles = np.concatenate([faces, np.array([(0, 1, 2), (0, 2, 3)]) + len(ball)])
    part = np.repeat([0, 1], [len(faces), 2])
    found = silhouette_areas(np.concatenate([2 * ball, plate]), triangles, part, 2)
    np.testing.assert_allclose(found, [4 * np.pi, 12 / np.sqrt(3)], rtol=0.03)
