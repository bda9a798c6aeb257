"""Agents at the borders of the map's cells, and at the map's own: where a step is cut (behaviour.advance)."""

import numpy as np

from ..crowd.maps import Area, LabelMap

# Cells that an agent has to have before it in a step, to pass those of one label at once.
FAR = 2
# A way shorter than this part of a cell is no progress.
PROGRESS = 1e-9
# Pieces of a step before agents are looked at that come back to where they were, or get nowhere.
MANY_PIECES = 8


def _borders(x, y, column, row, velocity, world: LabelMap, past=0):
    """Of the cells column, row (c,), the borders ahead of agents at x, y with `velocity` (2, c); `past` (2, c): those behind so
    many more cells.

    Each (2, c), x and y: place; cell, the last before the border; way, -1, 0 or 1; the cell beyond; whether that is off the
    map; the border.
    """
    place, cell = np.array((x, y)), np.array((column, row))
    size = np.array(world.cell)[:, None]
    low, high = np.array([[world.area.x_min, world.area.x_max], [world.area.y_min, world.area.y_max]]).T[..., None]
    way = np.sign(velocity).astype(np.intp)
    cell += way * past
    beyond = cell + way
    out = (beyond < 0) | (beyond >= np.array(world.labels.shape[::-1])[:, None])
    return place, cell, way, beyond, out, np.where(out, np.where(way > 0, high, low), low + (cell + (way > 0)) * size)


def on_border(x, y, column, row, velocity, world: LabelMap, edge: str) -> np.ndarray:
    """Whether agents stand on the border ahead, (c,); arguments as in `_borders`."""
    place, _, way, _, out, border = _borders(x, y, column, row, velocity, world)
    touches = np.abs(border - place) <= 4 * np.spacing(np.abs(border) + np.abs(place))
    return (touches & (way != 0) & ~(out & (edge == "clamp"))).any(axis=0)


def past(column, row, velocity, span, world: LabelMap) -> np.ndarray:
    """(2, c) intp: how many cells beyond their own, along x and y, agents that walk on for `span` (c,) may pass before they come
    to another label; arguments as in `_borders`. 0 for those who hardly get as far as that."""
    vx, vy = velocity
    at, way = row * world.labels.shape[1] + column, (vx > 0, vy > 0)
    found = np.zeros((2, len(at)), np.intp)
    far = np.abs(velocity / np.array(world.cell)[:, None]).max(axis=0) * span > FAR
    for axis, straight in enumerate((vy == 0, vx == 0)):
        (some,) = (far & straight).nonzero()
        if len(some):
            found[axis, some] = world.runs[axis, way[axis][some].astype(np.intp), at[some]]
    (some,) = (far & (vx != 0) & (vy != 0)).nonzero()
    if len(some):
        found[:, some] = world.squares[way[1][some].astype(np.intp), way[0][some].astype(np.intp), at[some]] - 1
    return found


def to_border(x, y, column, row, velocity, span, world: LabelMap, edge: str, past):
    """Agents that leave their cell within `span`, taken to its border, or through cells of their label to one `past` others, as
    far as they come; arguments as in `_borders`.

    Gives the seconds taken, x, y, column, row of the cell entered, the bits of `mirror` that the map's edge flips, and how many
    borders were crossed before the last, each (c,).
    """
    place, cell, way, beyond, out, border = _borders(x, y, column, row, velocity, world, past)
    own = np.array((column, row))
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(way == 0, np.inf, np.maximum((border - place) / velocity, 0))
    if edge == "clamp":
        time[out] = np.inf
    axis = (time[1] < time[0]).astype(np.intp)  # x first where both are reached at once
    one = np.arange(len(axis))
    taken = np.minimum(time.min(axis=0), span)
    place = place + velocity * taken
    ends = past.any(axis=0) & (time.min(axis=0) > span)  # among cells of its label
    if past.any():
        at = (place - np.array([[world.area.x_min], [world.area.y_min]])) / np.array(world.cell)[:, None]
        # who is on a border has crossed it only if that is the one in x, and the way ends at one in y
        at = np.where((way > 0) == ((axis == 1) & ~ends), np.floor(at), np.ceil(at) - 1).astype(np.intp)
        last, cell = cell, np.clip(at, np.minimum(own, cell), np.maximum(own, cell))
        cell[axis, one] = np.where(ends, cell, last)[axis, one]
    crossed = np.abs(cell - own).sum(axis=0)
    leaves_map = out[axis, one] & ~ends
    if edge == "wrap":
        low, high = np.array([[world.area.x_min, world.area.x_max], [world.area.y_min, world.area.y_max]]).T[..., None]
        beyond %= np.array(world.labels.shape[::-1])[:, None]
        border = np.where(out, np.where(way > 0, low, high), border)
    place[axis, one] = np.where(ends, place, border)[axis, one]
    enters = ~ends & (~leaves_map | (edge == "wrap"))
    cell[axis, one] = np.where(enters, beyond[axis, one], cell[axis, one])
    flips = (leaves_map << axis).astype(np.uint8) if edge == "reflect" else 0
    return taken, *world.into(*place, *cell), *cell, flips, crossed


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


class Rounds:
    """Agents in one step who are where they were go on in whole rounds; who takes ever more pieces to get nowhere stands.

    What they are compared with is the last of their pieces whose number is a power of two (Brent 1980), so that rounds of any
    number of pieces are found; as far as rounding lets them come back. most: pieces that a step has for an agent, and about as
    many more for each cell that it walks.
    """

    def __init__(self, most: int, area: Area):
        self.most, self.since = most, 0
        self.rounding = 4 * np.spacing(np.abs((area.x_min, area.y_min, area.x_max, area.y_max)).max())  # metres a border

    def piece(self, pieces: int, now: np.ndarray | None, rest: np.ndarray, gone: np.ndarray) -> tuple:
        """After so many `pieces`, of which none is left out from MANY_PIECES on: (times, seconds, round, caught, stands): how often
        agents go their round within `rest`, (k,), the seconds that one takes, (k,), and what is `gone` in it, (2, k); who gets
        nowhere, (k,) bool, and of these who stands.

        now: (6, k), all that their way depends on, x and y first, None where it depends on chance or timers; rest: (k,), the seconds left;
        gone: (2, k), the cells that they walked, and their reads of the table in the last piece.
        """
        count, marks = pieces - self.since, not pieces & (pieces - 1)
        times, took = np.zeros((2, len(rest)))
        whole = self.gone = gone + (self.gone if self.since else 0.0)
        if self.since and now is not None:
            took, off = self.had - rest, np.abs(now - self.met)
            back = (off[:2] <= self.rounding * whole[1]).all(axis=0) & ~off[2:].any(axis=0)
            back &= (took > 0) & (whole[0] > PROGRESS * count)
            times = np.floor(np.divide(rest, took, where=back, out=times))
        slow = whole[0] * self.most < count
        stands = slow & (marks and pieces >= self.most)
        caught = stands | (slow & (times * count >= self.most))
        if marks:
            self.since, self.met, self.had, self.gone = pieces, now, rest, np.zeros_like(gone)
        return times, took, whole, caught, stands

    def keep(self, goes: np.ndarray) -> None:
        """Forget the agents who do not go on, goes (k,) bool."""
        self.had, self.gone = self.had[goes], self.gone[:, goes]
        self.met = None if self.met is None else self.met[:, goes]
