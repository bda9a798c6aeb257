"""A body of many loose parts keeps what it shows, also of few triangles."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.simplification.components import areas
from crowd_lod_extension.crowd_lod.simplification.decimate import decimate

from ..support.bodies import drum


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


@pytest.mark.once
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
    found = areas(np.concatenate([2 * ball, plate]), triangles, part, 2)
    np.testing.assert_allclose(found, [4 * np.pi, 12 / np.sqrt(3)], rtol=0.03)
