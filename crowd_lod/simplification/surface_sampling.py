"""Where on triangles a surface is sampled."""

import numpy as np

from .triangle_mesh import edge_keys

PARTS = 60  # of a side: all samples of a lattice lie at whole ones


def lattice(fine: int, whole: bool = False) -> np.ndarray:
    """Barycentric weights (3, g) of a grid on a triangle.

    The triangle's middle comes first, then points inside it, then points on the first half of each
    edge: the neighbor has the other half. whole: on all of each edge. fine: points along an edge.
    """
    inside = [
        (i, j, fine - i - j)
        for i in range(1, fine)
        for j in range(1, fine - i)
        if 3 * i != fine or 3 * j != fine
    ]
    along = range(1, fine if whole else fine // 2 + 1)
    sides = [np.roll((fine - i, i, 0), k) for k in range(3) for i in along]
    return np.concatenate(
        [[(1 / 3, 1 / 3, 1 / 3)], np.reshape([*inside, *sides], (-1, 3)) / fine]
    ).T


def between(
    corners: np.ndarray, faces: np.ndarray, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The points of a lattice on some faces, those on shared edges once.

    corners: (3, m); faces: (j,); grid: (3, g). Returns faces (k,) and barycentric weights (3, k).
    """
    face = np.tile(faces, grid.shape[1])
    weights = np.repeat(grid, len(faces), axis=1)
    on_side = np.flatnonzero((weights == 0).any(axis=0))
    side = weights[:, on_side].argmin(axis=0)
    every = np.arange(len(on_side))
    ends, share = (
        [rows[side - k, every] for k in (2, 1)]
        for rows in (corners.take(face[on_side], 1), weights.take(on_side, 1))
    )
    low = np.round(PARTS * np.where(ends[0] < ends[1], *share)).astype(np.intp)
    _, first = np.unique(
        edge_keys(np.stack(ends), corners.max(initial=0) + 1) * (PARTS + 1) + low, return_index=True
    )
    once = np.ones(len(face), bool)
    once[np.delete(on_side, first)] = False
    return face[once], weights[:, once]
