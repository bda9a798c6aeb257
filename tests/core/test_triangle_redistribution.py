"""Triangles that move to where a LOD is farthest from its source."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.simplification.edge_collapse import collapse, held_sides, normals_of, quadrics_of
from crowd_lod_extension.crowd_lod.simplification.surface_fit import Fit
from crowd_lod_extension.crowd_lod.simplification.triangle_redistribution import share

from .test_decimate import edge_counts, hausdorff, sphere, terrain


def fitted(points, triangles, target, seams=()):
    """A Fit of the mesh collapsed to `target` triangles."""
    seams = np.reshape(seams, (-1, 2)).astype(int)
    rows = quadrics_of(points, triangles, held_sides(triangles, seams, len(points))), normals_of(points, triangles)
    new_points, new_triangles, landed, _ = finished(collapse(points, triangles, *rows, target))
    kept, new_triangles = np.unique(new_triangles, return_inverse=True)
    index = np.full(len(points), -1)
    index[kept] = np.arange(len(kept))
    return Fit(new_points[kept], new_triangles.reshape(-1, 3), points, triangles, index[landed], seams)


def two_balls():
    """A Fit of a large ball and a small one, of 60 triangles each, which would better be the large one's."""
    points, triangles = sphere()
    one, n = fitted(points, triangles, 60), len(points)
    lod, corners, landed = one.lod.points.T, one.lod.corners.T, one.landed
    return Fit(
        np.concatenate([lod, 0.05 * lod + (3, 0, 0)]),
        np.concatenate([corners, corners + len(lod)]),
        np.concatenate([points, 0.05 * points + (3, 0, 0)]),
        np.concatenate([triangles, triangles + n]),
        np.concatenate([landed, landed + len(lod)]),
        np.zeros((0, 2), int),
    )


@pytest.mark.parametrize("make", [lambda: fitted(*sphere(), 120), lambda: fitted(*terrain(), 120), two_balls])
def test_the_count_the_borders_and_a_source_point_for_each_stay(make):
    fit = make()
    count, sides = fit.lod.corners.shape[1], set(edge_counts(fit.lod.corners.T)[1])
    for _ in range(6):
        share(fit)
        fit.move(5)
        triangles, landed = fit.lod.corners.T, fit.landed
        assert count - 1 <= len(triangles) <= count
        assert set(edge_counts(triangles)[1]) == sides
        assert len(np.unique(np.sort(triangles, axis=1), axis=0)) == len(triangles)
        assert (np.bincount(landed[landed >= 0], minlength=fit.lod.points.shape[1]) > 0).all()


def test_triangles_go_where_the_distance_is_largest():
    fit, moved = two_balls(), two_balls()
    source = fit.source.points.T, fit.source.corners.T
    for _ in range(12):
        share(fit)
        fit.move(5)
        moved.move(5)
    for each in (fit, moved):
        each.restore()
    new_points, new_triangles = fit.lod.points.T, fit.lod.corners.T
    assert (new_points[new_triangles[:, 0], 0] < 2).sum() > 80
    assert hausdorff(source, (new_points, new_triangles)) < 0.8 * hausdorff(source, (moved.lod.points.T, moved.lod.corners.T))


def test_a_seam_stays_where_it_is():
    points, triangles = terrain(24)
    seam = 24 * np.arange(24) + 11
    edges, line = np.stack([seam[:-1], seam[1:]], 1), points[seam[0], 1]
    fit = fitted(points, triangles, 120, edges)
    before = fit.seams.shape[1]
    for _ in range(6):
        share(fit)
        fit.move(5)
    ends = fit.lod.points[1, np.unique(fit.seams)]
    assert fit.seams.shape[1] >= before / 2 and np.abs(ends - line).max() < 0.15
    corners = {frozenset(side) for t in fit.lod.corners.T.tolist() for side in zip(t, t[1:] + t[:1], strict=True)}
    assert all(frozenset(side) in corners for side in fit.seams.T.tolist())


def test_one_triangle_can_give_none():
    fit = fitted(np.eye(3), np.array([[0, 1, 2]]), 1)
    share(fit)
    assert fit.lod.corners.tolist() == [[0], [1], [2]]
