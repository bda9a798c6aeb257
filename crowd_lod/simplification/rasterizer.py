"""A small rasterizer, for silhouettes and the pictures of LODs."""

from collections.abc import Iterator

import numpy as np

from .triangle_mesh import ranges

MOST_PAIRS = 50_000  # of triangle and pixel, at a time: what fits in the processor's cache
EDGE = 1e-9  # pixels by which a center may miss an edge that it lies on, by rounding


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


def mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The pixels that triangles cover, (rows, columns) bool.

    Each triangle covers a row from where it begins in it to where it ends; centers on edges are
    covered. corners, shape: see `cover`.
    """
    rows, columns = shape
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    x, y = corners[u[:, 0] * v[:, 1] != u[:, 1] * v[:, 0]].transpose(2, 1, 0)
    low = np.ceil(y.min(axis=0) - 0.5).clip(0, rows)
    high = (np.floor(y.max(axis=0) - 0.5) + 1).clip(0, rows)
    count = (high - low).clip(0).astype(np.intp)
    # each triangle in each of its rows
    triangle = np.repeat(np.arange(len(count)), count)
    row = ranges(low.astype(np.intp), count)
    begin = np.full(len(row), np.inf)
    end = np.full(len(row), -np.inf)
    for p, q in ((0, 1), (1, 2), (2, 0)):
        (x_p, y_p), (x_q, y_q) = ((x[k].take(triangle), y[k].take(triangle)) for k in (p, q))
        crossed = np.flatnonzero(((y_p - row - 0.5) * (y_q - row - 0.5) <= 0) & (y_p != y_q))
        part = (row[crossed] + 0.5 - y_p[crossed]) / (y_q[crossed] - y_p[crossed])
        at = x_p[crossed] + part * (x_q[crossed] - x_p[crossed])
        begin[crossed] = np.minimum(begin[crossed], at)
        end[crossed] = np.maximum(end[crossed], at)
    first = np.ceil(begin - 0.5 - EDGE).clip(0, columns).astype(np.intp)
    last = (np.floor(end - 0.5 + EDGE) + 1).clip(0, columns).astype(np.intp)
    spans = np.flatnonzero(first < last)
    # how many begin less how many have ended
    begun, ended = (
        np.bincount(row[spans] * (columns + 1) + ends[spans], minlength=rows * (columns + 1))
        for ends in (first, last)
    )
    return np.cumsum((begun - ended).reshape(rows, columns + 1), axis=1, dtype=np.int32)[:, :-1] > 0


def edges(corners: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The pixels along the longest edges of triangles less than a pixel high.

    `mask` may miss parts of such: what is seen edge on. corners, shape: see `cover`; what lies
    outside is moved to the border. Returns rows (k,) and columns (k,).
    """
    sides = np.roll(corners, -1, axis=1) - corners
    squares = np.einsum("mkd,mkd->mk", sides, sides)
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    low = np.flatnonzero(doubled**2 < squares.max(axis=1, initial=0))
    first = squares[low].argmax(axis=1)
    begin = corners[low, first]
    side = sides[low, first]
    count = np.ceil(np.abs(side).max(axis=1, initial=0)).astype(np.intp) + 1
    part = ranges(np.zeros_like(count), count) / np.repeat((count - 1).clip(1), count)
    at = np.repeat(begin, count, axis=0) + part[:, None] * np.repeat(side, count, axis=0)
    column, row = np.floor(at).astype(np.intp).clip(0, (shape[1] - 1, shape[0] - 1)).T
    return row, column


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
