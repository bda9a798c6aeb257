"""Pairs of points that lie close to each other."""

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
    order = np.argsort(cell, kind="stable")
    cell = cell[order]
    begins = np.arange(len(cell)) + 1, np.searchsorted(cell, cell + columns - 1, "left")
    ends = (np.searchsorted(cell, cell + aside, "right") for aside in (1, columns + 1))
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
