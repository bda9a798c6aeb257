"""Where triangles are sampled, against all points counted one by one."""

from collections import Counter

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.simplification.surface_sampling import between, lattice

from .test_decimate import terrain


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
