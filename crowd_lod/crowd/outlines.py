"""The outlines of cells of a map: polygons with holes, for programs that know no cells."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..connected_components import connected_components

# Steps along the sides of cells, (columns, rows): east, north, west, south.
STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])


@dataclass(frozen=True)
class Outline:
    """The border of cells that hang together by their sides.

    outer: (k, 2) intp, the corners (column, row) in which the line turns, counter-clockwise. The
        cell (column, row) has the corners from (column, row) to (column + 1, row + 1).
    holes: the same of each hole, clockwise.
    No line meets itself; two lines may meet in a corner.
    """

    outer: np.ndarray
    holes: tuple[np.ndarray, ...]


def outlines(cells: np.ndarray) -> list[Outline]:
    """Return the outlines of the cells that are True, in the order of their first cells.

    cells: (rows, columns) bool. Cells that meet only in a corner do not hang together.
    """
    outer: dict[int, np.ndarray] = {}
    holes: dict[int, list[np.ndarray]] = {}
    for part, corners in _rings(_parts(cells)):
        x, y = corners.T
        if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0:  # twice the area
            outer[part] = corners
        else:
            holes.setdefault(part, []).append(corners)
    return [Outline(outer[part], tuple(holes.get(part, ()))) for part in sorted(outer)]


def _parts(cells: np.ndarray) -> np.ndarray:
    """Return the number of the part that each cell belongs to, (rows + 2, columns + 2) intp, with a rim.

    It is -1 for none.
    """
    number = np.arange(cells.size).reshape(cells.shape)
    beside, above = cells[:, 1:] & cells[:, :-1], cells[1:] & cells[:-1]
    joined = np.hstack([(number[:, 1:][beside], number[:, :-1][beside]), (number[1:][above], number[:-1][above])])
    first = connected_components(cells.size, joined.T).reshape(cells.shape)
    return np.pad(np.where(cells, first, -1), 1, constant_values=-1)


def _rings(parts: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (part, (k, 2) corners in which it turns) of each closed line that has one part to its left.

    parts: as _parts has them.
    """
    # of each corner and each step from it, the part to the left
    left = np.stack([parts[1:, 1:], parts[1:, :-1], parts[:-1, :-1], parts[:-1, 1:]], axis=-1)
    left = np.where(left != np.roll(left, 1, axis=-1), left, -1)  # where there is no border, none
    row, column, step = np.nonzero(left >= 0)
    own, index = left[row, column, step], np.full(left.shape, -1)
    index[row, column, step] = np.arange(len(row))
    end_row, end_column = row + STEPS[step, 1], column + STEPS[step, 0]
    following = np.empty(len(row), np.intp)
    # Where cells of the part meet in a corner, the line goes on to the right: so it never comes back there.
    for turn in (1, 0, 3):
        on = end_row, end_column, (step + turn) % 4
        same = left[on] == own
        following[same] = index[on][same]
    after, left_over = following.tolist(), np.ones(len(row), bool)
    for first in range(len(row)):
        if not left_over[first]:
            continue
        ring = [first]
        while after[ring[-1]] != first:
            ring.append(after[ring[-1]])
        left_over[ring] = False
        turns = [edge for edge, before in zip(ring, ring[-1:] + ring[:-1], strict=True) if step[edge] != step[before]]
        yield int(own[first]), np.stack([column[turns], row[turns]], axis=1)


def section(points: np.ndarray, triangles: np.ndarray, z: float) -> np.ndarray:
    """Return the lines in which triangles meet the level plane at the height `z`.

    They are (k, 2, 2) float64, the segments' ends (x, y).

    points: (n, 3) float64; triangles: (m, 3) indices.
    A point in the plane counts as above it. So the lines of a closed surface are closed.
    """
    corners = points[triangles]
    above = corners[..., 2] >= z
    crossed = above != np.roll(above, -1, axis=1)  # of each side
    through = crossed.any(axis=1)  # then two sides are
    begin = corners[through][crossed[through]]
    end = np.roll(corners[through], -1, axis=1)[crossed[through]]
    # from below, so that neighbors find the same point
    down = begin[:, 2] >= z
    begin[down], end[down] = end[down], begin[down]
    part = (z - begin[:, 2:]) / (end[:, 2:] - begin[:, 2:])
    return (begin + part * (end - begin))[:, :2].reshape(-1, 2, 2)
