"""Agents at the borders of the map's cells, and at the map's own: where a step is cut (behaviour.advance)."""

import numpy as np

from .maps import Area, LabelMap


def _borders(x, y, column, row, velocity, world: LabelMap):
    """Of the cells column, row (c,), the borders ahead of agents at x, y with `velocity` (2, c).

    Each (2, c), x and y: place; cell; way, -1, 0 or 1; the cell beyond; whether that is off the map; the border.
    """
    place, cell = np.array((x, y)), np.array((column, row))
    size = np.array(world.cell)[:, None]
    low, high = np.array([[world.area.x_min, world.area.x_max], [world.area.y_min, world.area.y_max]]).T[..., None]
    way = np.sign(velocity).astype(np.intp)
    beyond = cell + way
    out = (beyond < 0) | (beyond >= np.array(world.labels.shape[::-1])[:, None])
    return place, cell, way, beyond, out, np.where(out, np.where(way > 0, high, low), low + (cell + (way > 0)) * size)


def on_border(x, y, column, row, velocity, world: LabelMap, edge: str) -> np.ndarray:
    """Whether agents stand on the border ahead, (c,); arguments as in `_borders`."""
    place, _, way, _, out, border = _borders(x, y, column, row, velocity, world)
    touches = np.abs(border - place) <= 4 * np.spacing(np.abs(border) + np.abs(place))
    return (touches & (way != 0) & ~(out & (edge == "clamp"))).any(axis=0)


def to_border(x, y, column, row, velocity, span, world: LabelMap, edge: str):
    """Agents that leave their cell within `span`, taken to its border; arguments as in `_borders`.

    Gives the seconds to the border, x, y, column, row of the cell entered, and the bits of `mirror` that the map's edge
    flips, each (c,).
    """
    place, cell, way, beyond, out, border = _borders(x, y, column, row, velocity, world)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(way == 0, np.inf, np.maximum((border - place) / velocity, 0))
    if edge == "clamp":
        time[out] = np.inf
    axis = (time[1] < time[0]).astype(np.intp)  # x first where both are reached at once
    one = np.arange(len(axis))
    taken = np.minimum(time.min(axis=0), span)
    place = place + velocity * taken
    leaves_map = out[axis, one]
    if edge == "wrap":
        low, high = np.array([[world.area.x_min, world.area.x_max], [world.area.y_min, world.area.y_max]]).T[..., None]
        beyond %= np.array(world.labels.shape[::-1])[:, None]
        border = np.where(out, np.where(way > 0, low, high), border)
    place[axis, one] = border[axis, one]
    enters = ~leaves_map | (edge == "wrap")
    cell[axis, one] = np.where(enters, beyond[axis, one], cell[axis, one])
    flips = (leaves_map << axis).astype(np.uint8) if edge == "reflect" else 0
    return taken, *world.into(*place, *cell), *cell, flips


def same_beside(column, row, to_column, to_row, world: LabelMap) -> np.ndarray:
    """(c,) bool: whether the cells to_column, to_row (c,) lie at a side of column, row (c,), and bear the same label."""
    beside = np.abs(to_column - column) + np.abs(to_row - row) == 1
    return beside & (world.labels[row, column] == world.labels[to_row, to_column])


def outside(x: np.ndarray, y: np.ndarray, area: Area) -> np.ndarray:
    """Whether places x, y (n,) lie outside the area, (n,) bool."""
    return (x < area.x_min) | (x > area.x_max) | (y < area.y_min) | (y > area.y_max)


def leaves_map(x: np.ndarray, y: np.ndarray, velocity: np.ndarray, area: Area) -> np.ndarray:
    """Whether agents at x, y (m,) on the area's border, or beyond it, would move outwards at `velocity` (2, m)."""
    vx, vy = velocity
    return (
        ((x <= area.x_min) & (vx < 0)) | ((x >= area.x_max) & (vx > 0))
        | ((y <= area.y_min) & (vy < 0)) | ((y >= area.y_max) & (vy > 0))
    )  # fmt: skip


def rounds(now: np.ndarray, met: np.ndarray, agents: np.ndarray, idle: np.ndarray, patience: int) -> np.ndarray:
    """Border crossings (c,) int32 that need not be done one by one: whole rounds of agents that are where they were.

    now: (7, c), all that the way of `agents` (c,) depends on, and the seconds left, which some roundings use up; met: (7, n),
    the same of all agents at the first crossing of those in a row, `idle` (c,) of them so far, that made no progress. Of
    `patience` at least one is left to be done.
    """
    first, later = idle == 1, np.flatnonzero(idle > 1)
    met[:, agents[first]] = now[:, first]
    skipped = np.zeros_like(idle)
    if not len(later):
        return skipped
    (*here, rest), (*before, had) = now[:, later], met[:, agents[later]]
    back = later[np.equal(here, before).all(axis=0) & (rest > patience * (had - rest))]
    period = idle[back] - 1
    skipped[back] = (patience - 1 - idle[back]) // period * period
    return skipped
