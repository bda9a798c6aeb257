"""Cut steps at the borders of map cells and of the map (for behavior/step.py)."""

from typing import NamedTuple

import numpy as np

from ..crowd.maps import Area, LabelMap

# Cells that an agent has to have before it in a step, to pass those of one label at once.
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

    def of(self, some: np.ndarray) -> "Walkers":
        """Return those at the indices `some`, (k,) intp."""
        return Walkers(*(each.take(some, 1) for each in self))


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
    """What agents have done who went to the border of their cell.

    taken: (c,) seconds.
    place: (2, c) world meters.
    cell: (2, c) column and row of the cell entered.
    flips: (c,) uint8, the bits of `mirror` that the map's edge flips.
    crossed: (c,) intp, the borders crossed before the last one.
    """

    taken: np.ndarray
    place: np.ndarray
    cell: np.ndarray
    flips: np.ndarray
    crossed: np.ndarray


def _borders(walkers: Walkers, world: LabelMap, past: np.ndarray | int = 0) -> Borders:
    """Return the borders that agents walk toward.

    past: (2, c), cells beyond the agent's own that it may pass before the border, along x and y.
    """
    low, high = world.area.bounds
    way = np.sign(walkers.velocity).astype(np.intp)
    last = walkers.cell + way * past
    beyond = last + way
    out = (beyond < 0) | (beyond >= np.array(world.labels.shape[::-1])[:, None])
    at = np.where(
        out, np.where(way > 0, high, low), low + (last + (way > 0)) * np.array(world.cell)[:, None]
    )
    return Borders(last, way, beyond, out, at)


def on_border(walkers: Walkers, world: LabelMap, edge: str) -> np.ndarray:
    """Return whether agents stand on the border that they walk toward, (c,) bool.

    With the edge policy "clamp" the map's own border does not count.
    """
    place, border = walkers.place, _borders(walkers, world)
    touches = np.abs(border.at - place) <= 4 * np.spacing(np.abs(border.at) + np.abs(place))
    return (touches & (border.way != 0) & ~(border.out & (edge == "clamp"))).any(axis=0)


def past(walkers: Walkers, span: np.ndarray, world: LabelMap) -> np.ndarray:
    """Return how many cells agents may pass before they reach another label.

    span: (c,) seconds that the agents walk on.

    Returns (2, c) intp, cells beyond the agent's own along x and y; 0 for agents that walk no more
    than FAR cells in `span`.
    """
    (vx, vy), (column, row) = walkers.velocity, walkers.cell
    at, way = row * world.labels.shape[1] + column, (vx > 0, vy > 0)
    found = np.zeros((2, len(at)), np.intp)
    far = np.abs(walkers.velocity / np.array(world.cell)[:, None]).max(axis=0) * span > FAR
    for axis, straight in enumerate((vy == 0, vx == 0)):
        (some,) = (far & straight).nonzero()
        if len(some):
            found[axis, some] = world.runs[axis, way[axis][some].astype(np.intp), at[some]]
    (some,) = (far & (vx != 0) & (vy != 0)).nonzero()
    if len(some):
        found[:, some] = (
            world.squares[way[1][some].astype(np.intp), way[0][some].astype(np.intp), at[some]] - 1
        )
    return found


def to_border(
    walkers: Walkers, span: np.ndarray, past: np.ndarray, world: LabelMap, edge: str
) -> Crossing:
    """Move agents that leave their cell within `span` to the border of that cell.

    span: (c,) seconds.
    past: (2, c), from `past`. An agent with `past` walks on through cells of its own label, to the
        border behind them or as far as `span` lets it.
    edge: the machine's policy at the map's edge.
    """
    own, cell, (low, high) = walkers.cell, walkers.cell.copy(), world.area.bounds
    last, way, beyond, out, border = _borders(walkers, world, past)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(
            way == 0, np.inf, np.maximum((border - walkers.place) / walkers.velocity, 0)
        )
    if edge == "clamp":
        time[out] = np.inf
    axis = (time[1] < time[0]).astype(np.intp)  # x first where both are reached at once
    one = np.arange(len(axis))
    taken = np.minimum(time.min(axis=0), span)
    place = walkers.place + walkers.velocity * taken
    ends = past.any(axis=0) & (time.min(axis=0) > span)  # among cells of its label
    if past.any():
        at = (place - low) / np.array(world.cell)[:, None]
        # who is on a border has crossed it only if that is the one in x, and the way ends at one in
        # y
        at = np.where((way > 0) == ((axis == 1) & ~ends), np.floor(at), np.ceil(at) - 1).astype(
            np.intp
        )
        cell = np.clip(at, np.minimum(own, last), np.maximum(own, last))
        cell[axis, one] = np.where(ends, cell, last)[axis, one]
    crossed = np.abs(cell - own).sum(axis=0)
    leaves_map = out[axis, one] & ~ends
    if edge == "wrap":
        beyond = beyond % np.array(world.labels.shape[::-1])[:, None]
        border = np.where(out, np.where(way > 0, low, high), border)
    place[axis, one] = np.where(ends, place, border)[axis, one]
    enters = ~ends & (~leaves_map | (edge == "wrap"))
    cell[axis, one] = np.where(enters, beyond[axis, one], cell[axis, one])
    flips = (
        (leaves_map << axis).astype(np.uint8)
        if edge == "reflect"
        else np.zeros(len(axis), np.uint8)
    )
    return Crossing(taken, np.array(world.into(*place, *cell)), cell, flips, crossed)


def same_beside(cell: np.ndarray, to: np.ndarray, world: LabelMap) -> np.ndarray:
    """Return whether two cells share a side and have the same label, (c,) bool.

    cell, to: (2, c) intp, column and row of the first cells, and of the second.
    """
    (column, row), (to_column, to_row) = cell, to
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
    (x, y), (vx, vy) = place, velocity
    return (
        ((x <= area.x_min) & (vx < 0)) | ((x >= area.x_max) & (vx > 0))
        | ((y <= area.y_min) & (vy < 0)) | ((y >= area.y_max) & (vy > 0))
    )  # fmt: skip
