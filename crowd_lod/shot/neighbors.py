"""Pairs of points that lie close to each other."""

from typing import Literal

import numpy as np


def close_pairs(
    place: np.ndarray, kind: np.ndarray, reach: float, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of points of one kind, at most `reach` apart: (pairs (m, 2), distances (m,)).

    place: (n, 3) meters. kind: (n,) whole numbers from 0 on. Pairs are intp, each is there once.
    most: of the pairs that are looked at; of a denser crowd every k-th point is asked for its
        neighbors.

    Points are sorted into square cells as wide as `reach`, row by row, a map for each kind. Those
    near a point then lie in two runs: what follows it up to the next cell of its row, and three
    cells of the row above.
    """
    cells = np.floor((place[:, :2] - place[:, :2].min(axis=0, initial=0.0)) / reach).astype(int) + 1
    columns, rows = cells.max(axis=0, initial=0) + 2
    cell = (kind.astype(int) * rows + cells[:, 1]) * columns + cells[:, 0]
    narrow = cell.astype(np.min_scalar_type(cell.max(initial=0)))  # 16 bits are sorted by radix
    order = np.argsort(narrow, kind="stable")
    cell = cell[order]
    first = np.flatnonzero(np.diff(cell, prepend=-1))  # of each cell's points
    count = np.diff(np.append(first, len(cell)))

    def find(aside: int, side: Literal["left", "right"]) -> np.ndarray:
        return np.repeat(np.searchsorted(cell, cell[first] + aside, side), count)

    begins = np.arange(len(cell)) + 1, find(columns - 1, "left")
    ends = find(1, "right"), find(columns + 1, "right")
    runs = [(begin, np.maximum(end - begin, 0)) for begin, end in zip(begins, ends, strict=True)]
    every = sum(int(length.sum()) for _, length in runs) // max(most, 1) + 1
    asked = np.arange(0, len(cell), every)
    partners = [_expanded(asked, begin[asked], length[asked]) for begin, length in runs]
    pairs = order[np.concatenate(partners)]
    apart = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    close = apart <= reach
    return pairs[close], apart[close]


def _expanded(points: np.ndarray, begin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return (m, 2) intp: each of `points` with each of the numbers of its run."""
    ends = np.cumsum(length)
    in_run = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - length, length)
    return np.column_stack((np.repeat(points, length), np.repeat(begin, length) + in_run))
