"""Closest points found by walking, against all triangles and against a finely sampled surface.

Samples on triangles, against all points counted one by one.
"""

from collections import Counter

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.simplification.closest_point import (
    between,
    closest_weights,
    doubt,
    lattice,
)
from crowd_lod_extension.crowd_lod.simplification.surface_fit import SurfaceFit
from crowd_lod_extension.crowd_lod.simplification.triangle_mesh import TriangleMesh, length

from .test_decimate import sphere, terrain


def least_by_samples(corners, others, fine=60):
    """The least distance (k,) from others (3, k) to a grid of points on the triangle `corners` (3,
    3).
    """
    i, j = np.meshgrid(np.arange(fine + 1), np.arange(fine + 1), indexing="ij")
    at = np.stack([i, j, fine - i - j])[:, i + j <= fine] / fine
    return np.linalg.norm((corners @ at)[:, None] - others[..., None], axis=0).min(axis=1)


def test_the_nearest_point_of_a_triangle_is_that_of_its_samples():
    random = np.random.default_rng(1)
    for corners in (random.normal(size=(3, 3)), np.array([[0, 1, 2], [0, 1e-3, 0], [0, 0, 0.0]])):
        others = random.normal(scale=2, size=(3, 200))
        a, b, c = (np.repeat(corners[:, [k]], 200, axis=1) for k in range(3))
        weights = closest_weights(others, a, b, c)
        assert (weights >= -1e-12).all() and np.allclose(weights.sum(axis=0), 1)
        away = length(others - (a * weights[0] + b * weights[1] + c * weights[2]))
        assert (away <= least_by_samples(corners, others) + 1e-9).all()
        assert (away >= least_by_samples(corners, others) - 0.05).all()


def test_a_walk_that_began_on_the_far_side_is_found_out():
    points, triangles = sphere()
    mesh = TriangleMesh(points.T.copy(), triangles.T.copy())
    others = 1.3 * points[::97].T
    face = np.full(others.shape[1], 5)
    weights = np.full((3, others.shape[1]), 1 / 3)
    face, weights = doubt(mesh, face, weights, others)
    every = [mesh.points.take(c, 1) for c in mesh.corners]
    for k, other in enumerate(others.T):
        all_of_them = np.repeat(other[:, None], len(triangles), axis=1)
        at = closest_weights(all_of_them, *every)
        least = length(all_of_them - sum(p * w for p, w in zip(every, at, strict=True))).min()
        assert np.isclose(
            length(others[:, [k]] - mesh.at(face[[k]], weights[:, [k]]))[0], least, rtol=0.02
        )


def test_flips_mend_sides_across_a_valley_but_no_seam():
    """A roof of two slopes whose LOD has its sides across the ridge: flipped along it, unless they
    are a seam.
    """
    points, triangles = terrain(13)
    points[:, 2] = -np.abs(points[:, 0] - 5)
    corners = np.array(
        [(0, 0, -5), (5, 0, 0), (10, 0, -5), (0, 10, -5), (5, 10, 0), (10, 10, -5.0)]
    )
    lod = np.array([(0, 2, 1), (0, 5, 2), (0, 3, 5), (3, 4, 5)])[:, ::-1]
    nearest = np.linalg.norm(points[:, None] - corners, axis=2).argmin(axis=1)
    mine = [np.linalg.norm(points - corner, axis=1).argmin() for corner in corners]
    seam = np.array([[mine[0], mine[5]]])
    for seams, sides in ((seam[:0], False), (seam, True)):
        fit = SurfaceFit(Mesh(corners, lod), Mesh(points, triangles), nearest, seams)
        fit.flip()
        fit.flip()
        kept = {
            frozenset(pair)
            for t in fit.lod.corners.T.tolist()
            for pair in zip(t, t[1:] + t[:1], strict=True)
        }
        assert (frozenset((0, 5)) in kept) == sides


@pytest.mark.parametrize("fine", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("every", [1, 3])
def test_each_place_on_triangles_is_sampled_once_open_sides_in_full(fine, every):
    """Of all triangles and of every third, whose sides are mostly open."""
    points, triangles = terrain(5)
    corners = triangles.T
    faces = np.arange(0, len(triangles), every)
    face, weights = between(corners, faces, lattice(fine, whole=True))
    found = np.einsum("kn,knd->nd", weights, points[corners[:, face]])
    wanted = []
    for corner in points[triangles[faces]]:
        inside = [
            (i, j, fine - i - j)
            for i in range(fine + 1)
            for j in range(fine + 1 - i)
            if max(i, j, fine - i - j) < fine
        ]
        wanted += [np.array(at) @ corner / fine for at in inside] + [corner.mean(axis=0)]
    assert Counter(map(tuple, np.round(found, 6))) == Counter(set(map(tuple, np.round(wanted, 6))))


def test_two_triangles_that_meet_share_the_samples_of_their_side():
    triangles = np.array([(0, 1, 2), (2, 1, 3)]).T
    points = np.random.default_rng(0).random((4, 3))
    halves = lattice(5)[:, 1:]
    at = [halves.T @ points[triangle] for triangle in triangles.T]
    here, there = ({tuple(np.round(p, 9)) for p in each} for each in at)
    side = {tuple(np.round(points[1] + (points[2] - points[1]) * k / 5, 9)) for k in range(1, 5)}
    assert side <= here | there and not here & there
