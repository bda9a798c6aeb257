"""Decimation that heeds poses: what is straight at rest and bends keeps its rings."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.meshes import decimate
from crowd_lod_extension.crowd_lod.skin import Skin


def turn(angle):
    """Matrices (..., 3, 3) about x."""
    c, s = np.cos(angle), np.sin(angle)
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(*np.shape(angle), 3, 3)


def tube(rings=40, around=24):
    """A closed upright tube of radius 0.1 from z = -1 to 1."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    side = [np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.full(around, z)]) for z in np.linspace(-1, 1, rings)]
    points = np.concatenate([*side, [[0, 0, -1], [0, 0, 1]]])
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij"))
    k, low, high = (j + 1) % around, len(points) - 2, len(points) - 1
    a, b, c, d = i * around + j, i * around + k, (i + 1) * around + j, (i + 1) * around + k
    first, last = np.arange(around), np.arange(around) + (rings - 1) * around
    caps = [
        np.column_stack([np.roll(first, -1), first, np.full(around, low)]),
        np.column_stack([last, np.roll(last, -1), np.full(around, high)]),
    ]
    return points, np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c]), *caps])


def bent(points, angles, blend=0.3):
    """Linear blend skinning by two bones that meet at the origin, the upper one turned by each of `angles`."""
    upper = np.clip(points[:, 2] / blend + 0.5, 0, 1)[:, None, None]
    frame = np.stack([(1 - upper) * np.eye(3) + upper * turn(np.array(angle)) for angle in angles])
    return Skin(points, np.einsum("knij,nj->kni", frame, points), frame)


def distance(samples, points, triangles):
    """From each of samples (k, 3) to the surface, all triangles tried: to a plane where it falls inside, else to the sides."""
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = []
    for p in samples:
        height = np.einsum("md,md->m", p - corners[:, 0], normal)
        inside, nearest = np.ones(len(corners), bool), np.full(len(corners), np.inf)
        for i in range(3):
            a, side = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
            inside &= np.einsum("md,md->m", np.cross(side, p - a), normal) >= 0
            along = (np.einsum("md,md->m", p - a, side) / np.einsum("md,md->m", side, side)).clip(0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(p - a - along[:, None] * side, axis=1))
        found.append(np.where(inside, np.abs(height), nearest).min())
    return np.array(found)


@pytest.mark.parametrize("ratio", [0.5, 0.2])
def test_an_elbow_straight_at_rest_keeps_its_shape_when_it_bends(ratio):
    points, triangles = tube()
    skin = bent(points, [0.0, 0.7, 1.6])
    heeding, blind = decimate(points, triangles, ratio, "arm", skin=skin), decimate(points, triangles, ratio, "arm")
    assert len(heeding.triangles) <= len(blind.triangles) * 1.01
    off = [distance(skin.place[2], skin.at(2, lod.points.T, lod.source).T, lod.triangles).max() for lod in (heeding, blind)]
    assert off[0] < off[1] / 3
    assert distance(points, heeding.points, heeding.triangles).max() < 0.02


def test_a_point_moves_as_linear_blend_skinning_has_it():
    points, _ = tube()
    skin = bent(points, [1.1])
    rng = np.random.default_rng(0)
    follows = rng.integers(0, len(points), 50)
    off = rng.normal(0, 0.1, (50, 3))
    upper = np.clip(points[follows, 2] / 0.3 + 0.5, 0, 1)[:, None]
    wanted = (1 - upper) * (points[follows] + off) + upper * ((points[follows] + off) @ turn(np.array(1.1)).T)
    np.testing.assert_allclose(skin.at(0, (points[follows] + off).T, follows).T, wanted, atol=1e-12)
    moved = skin.scaled(np.array([1.0, 2.0, 3.0]), 4.0)
    there = moved.at(0, ((points[follows] + off - (1, 2, 3)) / 4).T, follows).T
    np.testing.assert_allclose(there, (wanted - (1, 2, 3)) / 4, atol=1e-12)


def test_the_poses_that_tell_most_come_first_and_those_that_tell_nothing_not_at_all():
    points, triangles = tube()
    skin = bent(points, [0.1, 1.5, 0.0, 1.5, 0.7])
    told = skin.telling(triangles, 2)
    np.testing.assert_array_equal(told.place, skin.place[[1, 4]])
    assert len(skin.telling(triangles, 9).place) == 3  # not the straight one, nor the same twice
    whole = np.broadcast_to(turn(np.array(1.0)), (1, len(points), 3, 3))
    turned = Skin(points, np.einsum("knij,nj->kni", whole, points), whole)  # all of it turns: nothing bends
    assert turned.telling(triangles) is None
    same, plain = decimate(points, triangles, 0.3, "arm", skin=turned), decimate(points, triangles, 0.3, "arm")
    np.testing.assert_array_equal(same.points, plain.points)
