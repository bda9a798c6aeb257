"""Loose parts of a mesh: that each shows as much as before."""

import numpy as np

from .rasterizer import mask

LOST = 0.03  # part of the source's silhouette: a part that lacks more is widened
FLAT = 0.01  # a part whose thickness is less than this part of its length is flat

CELL = 32  # pixels across the mask of a part, with one around it
# From where parts are looked at: the corners of a cube, (d, 2, 3) axes of the pictures.
_towards = np.array([(1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]) / np.sqrt(3)
_right = np.cross((0.0, 0.0, 1.0), _towards) * np.sqrt(1.5)
DIRECTIONS = np.stack([_right, np.cross(_towards, _right)], axis=1)


def grown(
    points: np.ndarray,
    triangles: np.ndarray,
    part: np.ndarray,
    target_areas: np.ndarray,
    most: float,
) -> np.ndarray:
    """Widen parts that show too little, and return the points (n, 3).

    A part is widened about its middle, by the same length along each of its own axes.
    points: (n, 3); triangles: (m, 3); part: (n,) the number of each point's part; target_areas:
    (p,) that the parts should show; most: length by which a part may be widened.
    """
    count = len(target_areas)
    middle = (
        np.stack([np.bincount(part, x, count) for x in points.T], axis=1)
        / np.bincount(part, minlength=count)[:, None]
    )
    off = points - middle[part]
    spread = [np.bincount(part, off[:, i] * off[:, j], count) for i in range(3) for j in range(3)]
    axes = np.linalg.eigh(np.stack(spread, axis=1).reshape(-1, 3, 3))[1]
    along = np.einsum("nd,ndk->nk", off, axes[part])
    reach = np.zeros((count, 3))  # the shortest first
    np.maximum.at(reach, part, np.abs(along))
    more = (
        target_areas / np.maximum(areas(points, triangles, part[triangles[:, 0]], count), 1e-300)
        - 1
    )
    more[more < LOST] = 0
    # as a box grows: (a + d) (b + d) + (b + d) (c + d) + (c + d) (a + d) is 1 + more times ab + bc
    # + ca; of what is flat (b + d) (c + d)
    (a, b, c) = reach.T
    flat = reach[:, 0] < FLAT * reach[:, 2]
    square, line, area = np.where(
        flat,
        (np.ones(count), b + c, b * c),
        (np.full(count, 3.0), 2 * (a + b + c), a * b + b * c + c * a),
    )
    wider = (np.sqrt(line**2 + 4 * square * area * more) - line) / (2 * square)
    scale = 1 + wider.clip(0, most)[:, None] / np.maximum(reach, FLAT * reach[:, 2:] + 1e-300)
    return middle[part] + np.einsum("nk,ndk->nd", along * scale[part], axes[part])


def areas(
    points: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int, cell: int = CELL
) -> np.ndarray:
    """The area (count,) of each part's silhouette, in the mean of DIRECTIONS.

    points: (n, 3); triangles: (m, 3); part: (m,) of each triangle, one at least of each part; cell:
    pixels across a part.
    """
    total = np.zeros(count)
    across = int(np.ceil(np.sqrt(count)))
    for axes in DIRECTIONS:
        flat = (points @ axes.T)[triangles]
        low = np.full((count, 2), np.inf)
        high = np.full((count, 2), -np.inf)
        np.minimum.at(low, part, flat.min(axis=1))
        np.maximum.at(high, part, flat.max(axis=1))
        size = np.maximum(high - low, 1e-300)
        place = np.stack([np.arange(count) % across, np.arange(count) // across], axis=1)
        at = ((flat - low[part, None]) / size[part, None] * (cell - 2) + 1) + cell * place[
            part, None
        ]
        covered = (
            mask(at, (across * cell, across * cell))
            .reshape(across, cell, across, cell)
            .sum(axis=(1, 3))
            .ravel()
        )
        total += covered[:count] * size.prod(axis=1)
    return total / (cell - 2) ** 2 / len(DIRECTIONS)
