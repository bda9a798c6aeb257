"""The least of a table within rectangles of it.

A sparse table (Bender, Farach-Colton 2000): the least of every square of 2^k cells is found once. A
rectangle is covered by a few of the largest squares that fit into it, which may overlap.
"""

import numpy as np

LONG = 8  # squares along a rectangle, at most; a longer one counts as wider


class RectangleMinima:
    """Answers what is least in rectangles of a table (rows, columns)."""

    def __init__(self, table: np.ndarray):
        self._squares = [table]
        side = 1
        while 2 * side <= max(table.shape):
            self._squares.append(_doubled(self._squares[-1], side))
            side *= 2

    def of(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the least of each rectangle, (m,).

        low, high: (m, 2), its first and last column and row, within the table. A rectangle longer
            than LONG times its width counts as wider: the least of cells beside it counts as well.
        """
        wide = high - low + 1
        side = np.maximum(wide.min(axis=1), -(-wide.max(axis=1) // LONG))
        power = np.frexp(side)[1] - 1  # of the largest squares that are no wider
        least = np.full(len(power), np.inf)
        for k in np.flatnonzero(np.bincount(power)):
            rows = np.flatnonzero(power == k)
            least[rows] = _least(self._squares[k], 2 ** int(k), low[rows], high[rows])
        return least


def _doubled(squares: np.ndarray, side: int) -> np.ndarray:
    """Return the least of each square twice as wide, (rows, columns), at its first cell.

    squares: (rows, columns), the same of squares of `side` cells. Cells beyond the table do not
        count.
    """
    doubled = squares.copy()
    doubled[:-side] = np.minimum(squares[:-side], squares[side:])
    doubled[:, :-side] = np.minimum(doubled[:, :-side], doubled[:, side:])
    return doubled


def _least(squares: np.ndarray, side: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the least of the cells from `low` to `high` (m, 2), of squares of `side` cells."""
    least = np.full(len(low), np.inf)
    last = np.maximum(high + 1 - side, low)
    across, up = (last - low).max(axis=0)
    for row in range(0, up + side, side):
        rows = np.minimum(low[:, 1] + row, last[:, 1])
        for column in range(0, across + side, side):
            columns = np.minimum(low[:, 0] + column, last[:, 0])
            np.minimum(least, squares[rows, columns], out=least)
    return least
