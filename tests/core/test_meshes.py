import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.meshes import decimate

pytest.importorskip("fast_simplification")


def torus(n=48, m=24, size=1.0):
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    points = np.stack([(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)], -1)
    i = np.arange(n * m).reshape(n, m)
    a, b, c, d = i, np.roll(i, -1, 0), np.roll(np.roll(i, -1, 0), -1, 1), np.roll(i, -1, 1)
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return points.reshape(-1, 3) * size, triangles


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.einsum("nd,nd->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("ratio", [0.4, 0.12])
def test_decimated_torus_stays_closed_and_keeps_its_shape(ratio, size):
    points, triangles = torus(size=size)
    lod = decimate(points, triangles, ratio, "torus")
    assert len(lod.triangles) == pytest.approx(ratio * len(triangles), rel=0.05)
    edges = np.sort(lod.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # no hole, no doubled face
    assert volume(lod.points, lod.triangles) == pytest.approx(volume(points, triangles), rel=0.08)
    # every point takes its weights from a source point close by
    assert np.linalg.norm(points[lod.source] - lod.points, axis=1).max() < 0.35 * size


def test_ratio_1_is_the_mesh_itself_without_loose_points():
    points, triangles = torus()
    points = np.vstack([[(9, 9, 9)], points])
    lod = decimate(points, triangles + 1, 1.0, "torus")
    assert (lod.points[lod.triangles] == points[triangles + 1]).all() and len(lod.points) == len(points) - 1
    assert (lod.source == np.arange(1, len(points))).all()


def test_one_triangle_survives_any_ratio():
    lod = decimate(np.eye(3), np.array([[0, 1, 2]]), 0.001, "card")
    assert len(lod.triangles) == 1


@pytest.mark.parametrize("ratio", [0, -1, 1.5, np.nan])
def test_bad_ratio(ratio):
    with pytest.raises(CrowdError, match="torus"):
        decimate(*torus(), ratio, "torus")


def test_empty_and_nan_meshes_are_named():
    with pytest.raises(CrowdError, match="ghost has no faces"):
        decimate(np.zeros((3, 3)), np.zeros((0, 3), int), 0.5, "ghost")
    points, triangles = torus()
    points[7, 1] = np.nan
    with pytest.raises(CrowdError, match="torus has 1 vertices at NaN"):
        decimate(points, triangles, 0.5, "torus")
