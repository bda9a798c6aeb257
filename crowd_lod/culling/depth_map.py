"""The depths behind which opaque scenery hides everything, on a coarse grid over the picture.

A cell that the border of a sheet does not touch is covered by it wholly or not at all, and its
middle tells which (culling/sheets.py). It hides what lies beyond the farthest of the sheet's
triangles in it.

The least of rectangles comes from a sparse table (Bender, Farach-Colton 2000): that of every square
of 2^k cells is found once. A rectangle is covered by a few of the largest squares that fit into it,
which may overlap.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .camera import Camera
from .occluders import Occluders
from .sheets import ROUNDING, Grid, Sheets, grid_of, place_components, read_sheets

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


LARGEST = 8  # components that are drawn first


def map_depths(occluders: Occluders, cameras: Sequence[Camera]) -> np.ndarray:
    """Return the map of nearness (rows, columns) float64, the bottom row first.

    -inf where a ray through the cell may pass. Else no ray of the camera gets beyond that nearness
    within the cell.

    cameras: PERSP or ORTHO; one, or one at the begin and the end of a time. The map then holds at
        all times between, if the camera moves on without turning back: cells that the border of a
        sheet does not pass stay covered, or uncovered.
    """
    grid = grid_of(cameras[0])
    low, high, nearest = place_components(occluders, cameras[0], grid)
    components = np.argsort(-(high - low).prod(axis=1))
    components = components[np.isfinite(nearest[components])]
    largest, smaller = np.split(components, [LARGEST])
    nearness = _draw(read_sheets(occluders, largest, cameras, grid), grid)
    # what lies behind these adds nothing: in a street five of six houses
    first = np.floor(low[smaller]).astype(np.intp)
    last = np.minimum(np.floor(high[smaller]), grid.size - 1).astype(np.intp)
    smaller = smaller[nearest[smaller] > RectangleMinima(nearness).of(first, last)]
    return np.maximum(nearness, _draw(read_sheets(occluders, smaller, cameras, grid), grid))


def _draw(sheets: Sheets, grid: Grid) -> np.ndarray:
    """Return the map of the sheets; each is drawn on a rectangle of cells of its own."""
    sheet = sheets.sheet
    count = int(sheet.max(initial=-1)) + 1
    low = np.full((count, 2), np.inf)
    high = np.full((count, 2), -np.inf)
    np.minimum.at(low, sheet, sheets.triangles[..., :2].min(axis=1))
    np.maximum.at(high, sheet, sheets.triangles[..., :2].max(axis=1))
    plots = _Plots(*_whole_cells(low, high, 0.0, grid))
    covered = np.zeros(plots.cells, bool)
    farthest = np.full(plots.cells, np.inf)
    _draw_triangles(sheets, grid, plots, covered, farthest)
    covered[_border_cells(sheets, grid, plots)] = False
    cells = np.flatnonzero(covered)
    nearness = np.full((grid.rows, grid.columns), -np.inf)
    columns, rows = plots.places(cells)
    depth = farthest[cells]
    np.maximum.at(nearness, (rows, columns), depth - ROUNDING * np.abs(depth))
    return nearness


@dataclass(frozen=True)
class _Plots:
    """A rectangle of cells for each sheet.

    low: (s, 2) int, its least column and row.
    wide: (s, 2) int, its numbers of columns and rows.
    """

    low: np.ndarray
    wide: np.ndarray

    @cached_property
    def begins(self) -> np.ndarray:
        """(s + 1,), the first cell of each in the list of all."""
        return np.cumsum([0, *self.wide.prod(axis=1)])

    @property
    def cells(self) -> int:
        """Their number."""
        return int(self.begins[-1])

    def numbers(self, sheet: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the cells at columns x and rows y of the sheets."""
        low = self.low[sheet]
        return self.begins[sheet] + (y - low[:, 1]) * self.wide[sheet, 0] + x - low[:, 0]

    def places(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (columns, rows) of the cells in the picture."""
        sheet = np.searchsorted(self.begins, cells, side="right") - 1
        row, column = np.divmod(cells - self.begins[sheet], self.wide[sheet, 0])
        return column + self.low[sheet, 0], row + self.low[sheet, 1]


def _whole_cells(
    low: np.ndarray, high: np.ndarray, slack: np.ndarray | float, grid: Grid
) -> tuple[np.ndarray, np.ndarray]:
    """Return (least column and row, numbers of them) of rectangles, each (m, 2) int."""
    first = np.clip(np.floor(low - slack), 0, grid.size).astype(np.intp)
    end = np.clip(np.floor(high + slack) + 1, 0, grid.size).astype(np.intp)
    return first, np.maximum(end - first, 0)


def _cells_of(low: np.ndarray, wide: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (which rectangle, column, row) of each cell of rectangles."""
    count = wide.prod(axis=1)
    rectangle = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(rectangle)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(place, wide[rectangle, 0])
    return rectangle, column + low[rectangle, 0], row + low[rectangle, 1]


def _draw_triangles(
    sheets: Sheets, grid: Grid, plots: _Plots, covered: np.ndarray, farthest: np.ndarray
) -> None:
    """Note cells whose middle a triangle covers, and the least nearness of those that touch one.

    Each row of a triangle has the cells from one column to another.
    """
    flat = sheets.triangles[..., :2]
    slack = sheets.slack
    low, wide = _whole_cells(flat.min(axis=1), flat.max(axis=1), slack, grid)
    first = plots.low[sheets.sheet]
    end = np.minimum(low + wide, first + plots.wide[sheets.sheet])
    low = np.maximum(low, first)
    triangle, y = _runs(low[:, 1], end[:, 1])
    sides = np.roll(flat, -1, axis=1) - flat
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    sides *= np.sign(area)[:, None, None]
    reach = (np.abs(sides) * (0.5 + slack[:, None, ::-1])).sum(axis=2) * (1 + ROUNDING) + ROUNDING
    touched = low[triangle, 0], end[triangle, 0]
    middles = touched
    for k in range(3):
        across = sides[triangle, k, 0] * (y + 0.5 - flat[triangle, k, 1])
        across += sides[triangle, k, 1] * (flat[triangle, k, 0] - 0.5)
        touched = _narrowed(touched, across + reach[triangle, k], sides[triangle, k, 1])
        middles = _narrowed(middles, across, sides[triangle, k, 1])
    numbers = plots.numbers(sheets.sheet[triangle], np.zeros_like(y), y)
    is_wide = np.abs(area) > ROUNDING
    row, x = _runs(middles[0], np.where(is_wide[triangle], middles[1], 0))
    covered[numbers[row] + x] = True
    start, slope, least = (
        values[triangle] for values in _planes(sheets.triangles, area, slack, is_wide)
    )
    start += slope[:, 1] * (y + 0.5) + slope[:, 0] * 0.5
    row, x = _runs(*touched)
    nearness = np.maximum(start[row] + slope[row, 0] * x, least[row])
    np.minimum.at(farthest, numbers[row] + x, nearness)


def _runs(first: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (which run, number) of each number of runs from `first` up to before `end`."""
    count = np.maximum(end - first, 0)
    run = np.repeat(np.arange(len(count)), count)
    return run, np.arange(len(run)) + np.repeat(first - np.cumsum(count) + count, count)


def _narrowed(
    columns: tuple[np.ndarray, np.ndarray], across: np.ndarray, fall: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns x, (first, end) of each row, in which across - fall x is not below 0."""
    first, end = columns
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        zero = across / fall
    least = np.fmin(np.fmax(np.ceil(zero - ROUNDING), first), end)
    most = np.fmax(np.fmin(np.floor(zero + ROUNDING) + 1, end), first)
    least = np.where(fall < 0, least, first)
    most = np.where(fall > 0, most, end)
    most[(fall == 0) & ~(across >= 0)] = 0
    return least.astype(np.intp), most.astype(np.intp)


def _planes(
    corners: np.ndarray, area: np.ndarray, slack: np.ndarray, is_wide: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the least nearness of triangles in a cell: (start (t,), slope (t, 2), least (t,)).

    It is start + slope . the cell's middle, and no less than `least`, which is that of the corners.
    """
    x1, y1, w1 = (corners[:, 1] - corners[:, 0]).T
    x2, y2, w2 = (corners[:, 2] - corners[:, 0]).T
    safe = np.where(is_wide, area, 1.0)
    slope = np.stack([w1 * y2 - w2 * y1, w2 * x1 - w1 * x2], axis=1) / safe[:, None]
    slope[~is_wide] = 0
    start = corners[:, 0, 2] - (np.abs(slope) * (0.5 + slack)).sum(axis=1)
    start -= (slope * corners[:, 0, :2]).sum(axis=1)
    least = corners[:, :, 2].min(axis=1)
    return np.where(is_wide, start, -np.inf), slope, least


def _border_cells(sheets: Sheets, grid: Grid, plots: _Plots) -> np.ndarray:
    """Return the cells that a border of their sheet touches."""
    ends = sheets.borders
    slack = sheets.border_slack
    low, wide = _whole_cells(ends.min(axis=1), ends.max(axis=1), slack, grid)
    first = plots.low[sheets.border_sheet]
    end = np.minimum(low + wide, first + plots.wide[sheets.border_sheet])
    low = np.maximum(low, first)
    border, x, y = _cells_of(low, np.maximum(end - low, 0))
    way = ends[:, 1] - ends[:, 0]
    across = way[border, 0] * (y + 0.5 - ends[border, 0, 1])
    across -= way[border, 1] * (x + 0.5 - ends[border, 0, 0])
    reach = (np.abs(way) * (0.5 + slack[:, ::-1])).sum(axis=1) + ROUNDING
    touches = np.abs(across) <= reach[border]
    border = border[touches]
    return plots.numbers(sheets.border_sheet[border], x[touches], y[touches])
