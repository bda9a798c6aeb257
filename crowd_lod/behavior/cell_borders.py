"""Cut steps at the borders of map cells and of the map (for behavior/plain_step.py)."""

from typing import NamedTuple

import numpy as np

from ..world.maps import Area, LabelMap

# Agents that walk more cells than this in a step pass those of one label at once.
FAR = 2


class Walkers(NamedTuple):
    """Agents on their way, the columns along x and y.

    place: (2, c) float64, world meters.
    cell: (2, c) intp, column and row of the map cells that they are in.
    velocity: (2, c) float64, m/s.
    """

    place: np.ndarray
    cell: np.ndarray
    velocity: np.ndarray

    def of(self, agents: np.ndarray) -> "Walkers":
        """Return those at the indices `agents`, (k,) intp."""
        return Walkers(*(column.take(agents, 1) for column in self))


class Borders(NamedTuple):
    """The cell borders that agents walk toward; each (2, c), along x and y.

    last: column and row of the last cell before the border.
    way: the direction -1, 0 or 1.
    beyond: column and row of the cell behind the border.
    out: bool, whether that cell is off the map.
    at: the border's coordinate, world meters.
    """

    last: np.ndarray
    way: np.ndarray
    beyond: np.ndarray
    out: np.ndarray
    at: np.ndarray


class Crossing(NamedTuple):
    """Where agents are who went to the border of their cell.

    seconds: (c,) that they took.
    place: (2, c) world meters.
    cell: (2, c) column and row of the cell entered.
    flips: (c,) uint8, the bits of `mirror` that the map's edge flips.
    crossed: (c,) intp, the borders crossed before the last one.
    """

    seconds: np.ndarray
    place: np.ndarray
    cell: np.ndarray
    flips: np.ndarray
    crossed: np.ndarray


def _borders(walkers: Walkers, world: LabelMap, cells_ahead: np.ndarray | int = 0) -> Borders:
    """Return the borders that agents walk toward.

    cells_ahead: (2, c), cells beyond the agent's own before the border, along x and y.
    """
    low, high = world.area.bounds
    way = np.sign(walkers.velocity).astype(np.intp)
    last = walkers.cell + way * cells_ahead
    beyond = last + way
    out = (beyond < 0) | (beyond >= np.array(world.labels.shape[::-1])[:, None])
    inner = low + (last + (way > 0)) * np.array(world.cell)[:, None]
    at = np.where(out, np.where(way > 0, high, low), inner)
    return Borders(last, way, beyond, out, at)


def on_border(walkers: Walkers, world: LabelMap, edge: str) -> np.ndarray:
    """Return whether agents stand on the border that they walk toward, (c,) bool.

    With the edge policy "clamp" the map's own border does not count.
    """
    border = _borders(walkers, world)
    apart = np.abs(border.at - walkers.place)
    touches = (apart <= world.rounding) & (border.way != 0)
    if edge == "clamp":
        touches &= ~border.out
    return touches.any(axis=0)


def count_cells_ahead(walkers: Walkers, span: np.ndarray, world: LabelMap) -> np.ndarray:
    """Return how many cells agents may pass before they reach another label.

    span: (c,) seconds that the agents walk on.

    Returns (2, c) intp, cells beyond the agent's own along x and y; 0 for agents that walk no more
    than FAR cells in `span`.
    """
    column, row = walkers.cell
    cell = row * world.labels.shape[1] + column
    right, up = (walkers.velocity > 0).astype(np.intp)
    moves_x, moves_y = walkers.velocity != 0
    size = np.array(world.cell)[:, None]
    is_far = np.abs(walkers.velocity / size).max(axis=0) * span > FAR
    cells = np.zeros((2, len(cell)), np.intp)
    for axis, way, is_straight in ((0, right, ~moves_y), (1, up, ~moves_x)):
        agents = np.flatnonzero(is_far & is_straight)
        if len(agents):
            cells[axis, agents] = world.runs[axis, way[agents], cell[agents]]
    agents = np.flatnonzero(is_far & moves_x & moves_y)
    if len(agents):
        cells[:, agents] = world.squares[up[agents], right[agents], cell[agents]] - 1
    return cells


def to_border(
    walkers: Walkers, span: np.ndarray, cells_ahead: np.ndarray, world: LabelMap, edge: str
) -> Crossing:
    """Move agents that leave their cell within `span` to the border of that cell.

    span: (c,) seconds.
    cells_ahead: (2, c), from count_cells_ahead. An agent with some walks on through cells of its
        label, to the border behind them or as far as `span` lets it.
    edge: the machine's policy at the map's edge.
    """
    border = _borders(walkers, world, cells_ahead)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.maximum((border.at - walkers.place) / walkers.velocity, 0)
    time[border.way == 0] = np.inf
    if edge == "clamp":
        time[border.out] = np.inf
    agents = np.arange(len(span))
    axis = (time[1] < time[0]).astype(np.intp)  # x first where both are reached at once
    crossed = axis, agents
    until_border = time.min(axis=0)
    seconds = np.minimum(until_border, span)
    place = walkers.place + walkers.velocity * seconds
    cell = walkers.cell.copy()
    ends = cells_ahead.any(axis=0) & (until_border > span)  # among cells of its label
    if cells_ahead.any():
        cell = _cells_passed(walkers, border, place, (axis == 1) & ~ends, world)
        cell[crossed] = np.where(ends, cell, border.last)[crossed]
    borders_before = np.abs(cell - walkers.cell).sum(axis=0)

    low, high = world.area.bounds
    beyond = border.beyond
    entry = border.at
    if edge == "wrap":
        beyond = beyond % np.array(world.labels.shape[::-1])[:, None]
        entry = np.where(border.out, np.where(border.way > 0, low, high), entry)
    leaves_area = border.out[crossed] & ~ends
    enters = ~ends & (~leaves_area | (edge == "wrap"))
    place[crossed] = np.where(ends, place, entry)[crossed]
    cell[crossed] = np.where(enters, beyond[crossed], cell[crossed])
    flips = np.zeros(len(span), np.uint8)
    if edge == "reflect":
        flips = (leaves_area << axis).astype(np.uint8)
    return Crossing(seconds, np.array(world.into(*place, *cell)), cell, flips, borders_before)


def _cells_passed(
    walkers: Walkers, border: Borders, place: np.ndarray, ends_at_y: np.ndarray, world: LabelMap
) -> np.ndarray:
    """Return (2, c) intp, the cells to which agents come on their way through cells of one label.

    place: (2, c) world meters, where they end.
    ends_at_y: (c,) bool, whether that is a border along y. An agent on a border along x has crossed
        it only then.
    """
    low, _ = world.area.bounds
    index = (place - low) / np.array(world.cell)[:, None]
    rounds_down = (border.way > 0) == ends_at_y
    cell = np.where(rounds_down, np.floor(index), np.ceil(index) - 1).astype(np.intp)
    first = np.minimum(walkers.cell, border.last)
    last = np.maximum(walkers.cell, border.last)
    return np.clip(cell, first, last)


def same_beside(cell: np.ndarray, to: np.ndarray, world: LabelMap) -> np.ndarray:
    """Return whether two cells share a side and have the same label, (c,) bool.

    cell, to: (2, c) intp, column and row of the first cells, and of the second.
    """
    column, row = cell
    to_column, to_row = to
    beside = np.abs(to_column - column) + np.abs(to_row - row) == 1
    return beside & (world.labels[row, column] == world.labels[to_row, to_column])


def outside(place: np.ndarray, area: Area) -> np.ndarray:
    """Return whether places (2, n), world meters, lie outside the area, (n,) bool."""
    x, y = place
    return (x < area.x_min) | (x > area.x_max) | (y < area.y_min) | (y > area.y_max)


def leaves_map(place: np.ndarray, velocity: np.ndarray, area: Area) -> np.ndarray:
    """Return whether agents would move off the map, (m,) bool.

    place: (2, m) world meters, on the area's border or beyond it; agents inside give False.
    velocity: (2, m) m/s.
    """
    x, y = place
    vx, vy = velocity
    return (
        ((x <= area.x_min) & (vx < 0)) | ((x >= area.x_max) & (vx > 0))
        | ((y <= area.y_min) & (vy < 0)) | ((y >= area.y_max) & (vy > 0))
    )  # fmt: skip
