"""A small rasterizer, for pictures of LODs and how much of a picture loose parts cover."""

from collections.abc import Iterator

import numpy as np

from .triangle_mesh import ranges

MOST_PAIRS = 50_000  # of triangle and pixel, at a time: what fits in the processor's cache


def cover(
    corners: np.ndarray, shape: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The pixels whose centers each triangle covers, some triangles at a time.

    corners: (m, 3, 2) float64, in pixels: x from the left edge, y from the edge of row 0. shape:
    rows and columns. Yields pixels (k,) intp, each row x columns + column; triangles (k,) intp;
    barycentric weights (k, 3) float64. Triangles seen edge on cover nothing; those that share an
    edge both cover the centers on it.
    """
    rows, columns = shape
    low = np.ceil(corners.min(axis=1) - 0.5).clip(0, (columns, rows)).astype(np.intp)
    high = (np.floor(corners.max(axis=1) - 0.5) + 1).clip(0, (columns, rows)).astype(np.intp)
    size = (high - low).clip(0)
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    chosen = np.flatnonzero((size.prod(axis=1) > 0) & (area != 0))
    pairs = size[chosen].prod(axis=1)
    for part in np.split(chosen, np.flatnonzero(np.diff(np.cumsum(pairs) // MOST_PAIRS)) + 1):
        count = size[part].prod(axis=1)
        triangle = np.repeat(part, count)
        place = ranges(np.zeros_like(count), count)
        row, column = np.divmod(place, size[triangle, 0])
        row = row + low[triangle, 1]
        column = column + low[triangle, 0]
        x = column + 0.5 - corners[triangle, 0, 0]
        y = row + 0.5 - corners[triangle, 0, 1]
        b = (x * v[triangle, 1] - y * v[triangle, 0]) / area[triangle]
        c = (y * u[triangle, 0] - x * u[triangle, 1]) / area[triangle]
        inside = (b >= 0) & (c >= 0) & (b + c <= 1)
        b = b[inside]
        c = c[inside]
        yield (
            row[inside] * columns + column[inside],
            triangle[inside],
            np.stack([1 - b - c, b, c], axis=1),
        )


def covered(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The pixels that triangles cover, (rows, columns) bool; corners, shape: see `cover`."""
    mask = np.zeros(shape[0] * shape[1], bool)
    for pixels, _, _ in cover(corners, shape):
        mask[pixels] = True
    return mask.reshape(shape)


def nearest(
    corners: np.ndarray, depth: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The triangle of the least depth at each covered pixel.

    corners, shape: see `cover`; depth: (m, 3), of the corners. Returns pixels (k,), triangles (k,),
    barycentric weights (k, 3).
    """
    parts = list(cover(corners, shape))
    if not parts:
        return np.empty(0, np.intp), np.empty(0, np.intp), np.empty((0, 3))
    pixel, triangle, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.lexsort(((depth[triangle] * weights).sum(axis=1), pixel))
    first = order[np.flatnonzero(np.diff(pixel[order], prepend=-1))]
    return pixel[first], triangle[first], weights[first]
