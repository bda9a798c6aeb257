"""Meshes seen from above as cells of a map."""

from collections.abc import Iterator

import numpy as np

from .maps import Area

OVERLAPS = 1_000_000  # triangles times cells that are compared at a time


def covered(triangles: np.ndarray, area: Area, rows: int, columns: int) -> np.ndarray:
    """Return which cells of a map (rows, columns) over `area` the triangles reach into, bool.

    A cell counts if any part of it lies under a triangle, so no wall is too thin to be there. A
    triangle that stands upright is a line from above, and counts where the line runs.

    triangles: (n, 3, 2), world x and y of their corners, meters.
    """
    scale = np.array([columns, rows]) / area.size
    corners = (
        np.asarray(triangles, np.float64).reshape(-1, 3, 2) - (area.x_min, area.y_min)
    ) * scale
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    longest = np.maximum((one**2).sum(axis=1), (other**2).sum(axis=1))
    upright = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) <= 1e-9 * longest
    found = np.zeros((rows, columns), bool)
    for cells, _, _ in _pairs(corners[~upright], rows, columns):
        found[cells[:, 1], cells[:, 0]] = True
    lines = np.zeros_like(found)
    for cells, touches, along_y in _pairs(corners[upright], rows, columns):
        # a line on the border of two cells, such as the side of a block, adds none where one is
        # covered
        before = cells - np.where(along_y[:, None], (1, 0), (0, 1))
        needless = touches & (before >= 0).all(axis=1) & found[before[:, 1], before[:, 0]]
        lines[cells[~needless, 1], cells[~needless, 0]] = True
    return found | lines


def _pairs(
    corners: np.ndarray, rows: int, columns: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the cells that triangles overlap, some triangles at a time: (cells, touches, along_y).

    cells: (m, 2), columns and rows. touches: (m,) bool, whether the triangle is a line on the
        border of the cell. along_y: (m,) bool, whether that line runs along y.
    corners: (n, 3, 2), in cells.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    first = np.floor(low).clip(0, [columns, rows]).astype(np.intp)
    last = (
        np.maximum(np.ceil(high), np.floor(low) + 1).clip(0, [columns, rows]).astype(np.intp)
    )  # after the last
    wide, deep = np.maximum(last - first, 0).T
    counts = wide * deep
    order = np.flatnonzero(counts)
    ends = np.cumsum(counts[order])
    begin = 0
    while begin < len(order):
        end = max(
            begin + 1,
            int(np.searchsorted(ends, (ends[begin - 1] if begin else 0) + OVERLAPS, "right")),
        )
        chosen = order[begin:end]
        which = np.repeat(chosen, counts[chosen])
        place = np.arange(len(which)) - np.repeat(
            np.cumsum(counts[chosen]) - counts[chosen], counts[chosen]
        )
        cells = first[which] + np.stack([place % wide[which], place // wide[which]], axis=1)
        overlap, touches = _overlap(corners[which], cells)
        size = (high - low)[which]
        yield cells[overlap], touches[overlap], (size[:, 1] > size[:, 0])[overlap]
        begin = end


def _overlap(corners: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whether each triangle overlaps its cell, and whether it only touches it.

    Their bounds overlap.

    By separating axes: the cell is off the triangle if all of it lies beyond one of its edges. A
    triangle that is a line overlaps a cell that it touches.

    corners: (m, 3, 2), in cells.
    cells: (m, 2), columns and rows.
    """
    local = corners - (cells[:, None] + 0.5)  # the cell is the square of half a side about 0
    overlap, touching = np.ones(len(cells), bool), np.zeros(len(cells), bool)
    for k in range(3):
        edge = local[:, (k + 1) % 3] - local[:, k]
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)
        along = np.einsum("mcd,md->mc", local, normal)
        reach = 0.5 * np.abs(normal).sum(axis=1)
        least, most = along.min(axis=1), along.max(axis=1)
        inside = (least < reach) & (most > -reach) | (
            reach == 0
        )  # an edge that is a point separates nothing
        touches = ~inside & (most - least <= 1e-9 * reach) & (least <= reach) & (most >= -reach)
        overlap &= inside | touches
        touching |= touches
    return overlap, touching
