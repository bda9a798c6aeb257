"""Behavior: agents step through the state machine on the label map (listing 1.1).

One read, one move: an agent reads the label under it. The OLD state and that label give both its
next state and its velocity. It moves. A step that stays in one cell is exactly this. So is a step
into a neighbor cell that shares a side and has the same label.

Every other step that would leave the cell is cut at the cell's border (Amanatides and Woo 1987).
Each piece is the listing again, with the label of the cell just entered. So no cell on an agent's
way goes unread, at any speed: the substeps follow from the Courant number of each agent alone. If
both borders are reached at once, the border in x is crossed first. So the way leads through the
sides of cells, never through a corner, and passes no wall, not even one whose cells touch only at
their corners. A timer that ends within a step cuts it too.

The cost of a step is bounded. Cells of one label are passed at once. An agent that turns more often
than its way is worth is stuck, in a corner between walls, say: it stands until the step ends. So does one
that the table leads round and round in place.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.leave_outs import NOTHING, ONE_LABEL, LeftOut
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from ..progress import breath
from . import cell_borders
from .cell_borders import Walkers
from .courant_number import check_speeds
from .tabulated_step import Tables, mended, within

# So many pieces may an agent take in a step, and so many more for each cell that it walks, but
# never more than PIECES are left to it. One that has none left is stuck.
PIECES = 64
PIECES_A_CELL = 8
# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW_AGENTS = 3000


@dataclass(frozen=True)
class Tally:
    """The cost of one `advance`.

    reads: table reads, summed over all agents.
    held: (n,) bool, agents that were stuck and stood for the rest of the step.
    pieces: pieces of the agent that took most.
    """

    reads: int
    held: np.ndarray
    pieces: int


def step(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    leave: frozenset[LeftOut] = NOTHING,
    tables: Tables | None = None,
) -> Crowd:
    """Return the crowd `seconds` later, by listing 1.1 cut at the cell borders.

    At the map's edge the machine's policy decides: `clamp` slides along it, `stop` stands, `wrap`
    goes on at the other side, `reflect` goes on mirrored until the state changes.

    leave: parts to leave out, from leave_outs.needless.
    tables: the tables of this step, if they exist already; their maker has checked the speeds.

    Raises CrowdError if `tables` is None and the table moves more than courant_number.MOST_CELLS
    cells in `seconds`.
    """
    if tables is None:
        check_speeds(machine, world, seconds)
    if len(crowd) < FEW_AGENTS:
        return advance(crowd, machine, world, seconds, leave=leave)[0]
    moved, rest = within(crowd, machine, world, tables or Tables(machine, seconds), leave)
    return mended(
        moved, crowd, rest, lambda some: advance(some, machine, world, seconds, leave=leave)[0]
    )


def advance(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    exact: bool = False,
    leave: frozenset[LeftOut] = NOTHING,
) -> tuple[Crowd, Tally]:
    """Return (crowd, Tally) `seconds` later, every agent stepped piece by piece.

    exact: take the limit of ever shorter steps. An agent whose state changes then moves no further
        than out of the cell on whose border it stands, and reads the table again
        (behavior/exact_walk.py).
    leave: parts to leave out, from leave_outs.needless.
    """
    way = _Way(crowd, machine, world, seconds, exact, leave)
    while len(way.rest):
        breath()
        way.go()
    now = way.now
    now.pace[:] = pace_of(now.x, now.y, now.state, machine, world)
    return now, Tally(way.reads, way.held, way.pieces)


@dataclass
class _Piece:
    """One read of the table and one move of the k agents on their way.

    walkers: where they are, and the velocity that they read.
    label: (k,) uint8, of the cells they are in; (1,) if all of the map has one.
    changed: (k,) bool, whose state the read has changed.
    span: (k,) seconds that they walk.
    to, to_cell: (2, k), where that leads, meters, and column and row of the cell there.
    leaves: (c,) intp, which of them are stopped at a border.
    reads: (k,) intp, table reads.
    """

    walkers: Walkers
    label: np.ndarray
    changed: np.ndarray
    span: np.ndarray
    to: np.ndarray
    to_cell: np.ndarray
    leaves: np.ndarray
    reads: np.ndarray


class _Way:
    """The way of a crowd through one step, piece by piece, until no agent has time left.

    now: the crowd, as far as it has come; its columns are written to.
    agents: which of the crowd's n agents are still on their way: k indices, or at first all.
    cell: (2, k) intp, column and row of the cells they are in.
    rest: (k,) seconds they have left.
    left: (k,) the pieces that each of them may still take.
    held, reads, pieces: see Tally.
    """

    def __init__(
        self,
        crowd: Crowd,
        machine: StateMachine,
        world: LabelMap,
        seconds: float,
        exact: bool,
        leave: frozenset[LeftOut],
    ):
        self.machine, self.world, self.exact, self.leave = machine, world, exact, leave
        self.draws, self.reflects = machine.timed or machine.chancy, machine.edge == "reflect"
        area = world.area
        self.now = now = replace(
            crowd,
            x=np.clip(crowd.x, area.x_min, area.x_max),
            y=np.clip(crowd.y, area.y_min, area.y_max),
            heading=crowd.heading.copy(),
            state=crowd.state.copy(),
            wait=crowd.wait.copy() if machine.timed else crowd.wait,
            key=crowd.key.copy() if self.draws else crowd.key,
            mirror=crowd.mirror.copy() if self.reflects else crowd.mirror,
            pace=np.empty_like(crowd.pace),
        )
        self.agents: np.ndarray | slice = slice(None)
        self.cell = np.array(world.cells(now.x, now.y))
        self.rest = np.full(len(crowd), float(seconds))
        # in no time an agent sees at most the 4 cells round a corner in each state: if it goes on
        # for longer, it has met one twice
        self.patience = max(PIECES, 4 * len(machine.states) + 4) if exact else PIECES
        self.left = np.full(len(crowd), float(self.patience))
        self.idle = np.zeros(len(crowd), np.intp)
        self.mark = np.full(len(crowd), -1)
        self.rounding = 4 * np.spacing(np.abs(area.bounds).max())
        self.held, self.reads, self.pieces = np.zeros(len(crowd), bool), 0, 0
        self.size = np.array(world.cell)[:, None]
        # NumPy is several times faster along rows than across pairs
        self.table = np.ascontiguousarray(machine.velocity.reshape(-1, 2).T)

    def go(self) -> None:
        """Take all who are on their way one piece further."""
        if self.machine.timed:
            self._time_out()
        piece = self._aimed(*self._read())
        if len(piece.leaves) and not self.exact:
            self._enter_alike(piece)
        if len(piece.leaves):
            self._stop_at_border(piece)
        self._move(piece)
        self._go_on(piece)

    def who(self, some: np.ndarray) -> np.ndarray:
        """Return the crowd's indices of `some`, (j,) intp indices of those on their way."""
        return some if isinstance(self.agents, slice) else self.agents[some]

    def _time_out(self) -> None:
        """Move those whose timer has run out into their next state."""
        now, machine = self.now, self.machine
        out = self.who(np.flatnonzero(now.wait[self.agents] <= 0))
        now.state[out] = machine.timed_out(now.state[out], now.key[out])
        now.key[out] = random_streams.moved_on(now.key[out], np.ones(len(out), bool))
        now.wait[out] = machine.waits(now.state[out], now.key[out])

    def _read(self) -> tuple[Walkers, np.ndarray, np.ndarray]:
        """Read the table: the old state and the label give the velocity and the next state.

        Returns walkers, label and changed, as in _Piece.
        """
        now, machine, agents = self.now, self.machine, self.agents
        old, (column, row) = now.state[agents], self.cell
        label = (
            self.world.labels[:1, 0] if ONE_LABEL in self.leave else self.world.labels[row, column]
        )
        velocity = self.table.take(old.astype(np.intp) * len(machine.labels) + label, axis=1)
        new = machine.following(old, label, now.key[agents])
        changed = new != old
        now.state[agents] = new
        if self.reflects:
            velocity = velocity * np.stack(
                [1.0 - 2 * (now.mirror[agents] & 1), 1.0 - (now.mirror[agents] & 2)]
            )
            now.mirror[agents] *= ~changed
        if self.draws:
            now.key[agents] = random_streams.moved_on(now.key[agents], changed)
            into = self.who(np.flatnonzero(changed))
            now.wait[into] = machine.waits(now.state[into], now.key[into])
        place = np.array((now.x[agents], now.y[agents]))
        if machine.edge == "stop":
            velocity[:, cell_borders.leaves_map(place, velocity, self.world.area)] = 0
        return Walkers(place, self.cell, velocity), label, changed

    def _aimed(self, walkers: Walkers, label: np.ndarray, changed: np.ndarray) -> _Piece:
        """Return the piece up to the end of the step or of a timer, through any border."""
        world, edge = self.world, self.machine.edge
        span = (
            np.minimum(self.rest, self.now.wait[self.agents])
            if self.machine.timed
            else self.rest.copy()
        )
        if self.exact:
            span[changed] = 0
        to = walkers.place + walkers.velocity * span
        to_cell = np.array(world.cells(*to))
        leaves = (to_cell[0] != walkers.cell[0]) | (to_cell[1] != walkers.cell[1])
        if edge != "clamp":
            leaves |= cell_borders.outside(to, world.area)
        if self.exact or self.pieces:
            # on a border and heading out: however short the move, even if rounding loses it, it
            # leaves the cell
            leaves |= cell_borders.on_border(walkers, world, edge)
        return _Piece(
            walkers,
            label,
            changed,
            span,
            to,
            to_cell,
            np.flatnonzero(leaves),
            np.ones(len(span), np.intp),
        )

    def _enter_alike(self, piece: _Piece) -> None:
        """Let go on who enters a cell of the same label at its side: its read is known."""
        c, world = piece.leaves, self.world
        on = (
            cell_borders.same_beside(self.cell.take(c, 1), piece.to_cell.take(c, 1), world)
            & ~piece.changed[c]
        )
        if self.machine.edge != "clamp":
            on &= ~cell_borders.outside(piece.to.take(c, 1), world.area)
        piece.leaves, on = c[~on], c[on]
        _put(self.cell, on, piece.to_cell.take(on, 1))
        piece.reads[on] += 1

    def _stop_at_border(self, piece: _Piece) -> None:
        """Stop who leaves its cell at the border, or at the end of cells of one label."""
        c, now, world = piece.leaves, self.now, self.world
        walkers, span = piece.walkers.of(c), piece.span[c]
        past = ~piece.changed[c] * cell_borders.past(walkers, span, world)
        crossing = cell_borders.to_border(walkers, span, past, world, self.machine.edge)
        _put(piece.to, c, crossing.place)
        _put(self.cell, c, crossing.cell)
        piece.span[c] = crossing.taken
        piece.reads[c] += crossing.crossed
        if self.reflects:
            now.mirror[self.who(c)] ^= crossing.flips
        if self.draws:
            entered, (column, row) = np.zeros(len(piece.span), bool), crossing.cell
            entered[c] = ONE_LABEL not in self.leave and world.labels[row, column] != piece.label[c]
            now.key[self.agents] = random_streams.moved_on(now.key[self.agents], entered)

    def _move(self, piece: _Piece) -> None:
        """Walk the piece."""
        now, agents, area = self.now, self.agents, self.world.area
        now.x[agents] = np.clip(piece.to[0], area.x_min, area.x_max)
        now.y[agents] = np.clip(piece.to[1], area.y_min, area.y_max)
        vx, vy = piece.walkers.velocity
        now.heading[agents] = np.where(
            np.hypot(vx, vy) > 0, np.arctan2(vy, vx), now.heading[agents]
        )
        if self.machine.timed:
            now.wait[agents] -= piece.span
        self.rest = self.rest - piece.span
        self.pieces, self.reads = self.pieces + 1, self.reads + int(piece.reads.sum())

    def _go_on(self, piece: _Piece) -> None:
        """Keep those who have time left, less those who are stuck."""
        on = np.flatnonzero(self.rest > 0)
        cells = piece.span[on] * np.abs(piece.walkers.velocity.take(on, 1) / self.size).max(axis=0)
        left = np.minimum(self.left[on] + PIECES_A_CELL * cells, self.patience) - 1
        stuck = (left <= 0) | self._goes_in_rounds(piece, on)
        if stuck.any():
            stand = self.who(on[stuck])
            self.held[stand] = True
            if self.machine.timed:
                self.now.wait[stand] -= self.rest[on[stuck]]
            on, left = on[~stuck], left[~stuck]
            self.idle = self.idle[~stuck]
            self.mark = self.mark[~stuck]
        self.agents = self.who(on)
        self.cell = self.cell.take(on, 1)
        self.rest = self.rest[on]
        self.left = left

    def _goes_in_rounds(self, piece: _Piece, on: np.ndarray) -> np.ndarray:
        """Return (j,) bool, agents that came back in place to a cell and state they were in.

        The table leads them round and round in next to no time, so they never leave the place. Each
        agent's condition is compared with the one it had 1, 2, 4, 8 ... pieces ago (Brent 1980).

        on: (j,) intp, which of those on their way have time left.
        """
        machine = self.machine
        span = piece.span[on]
        moved = (np.abs(piece.walkers.velocity.take(on, 1)) * span).max(axis=0)
        in_place = (moved <= self.rounding) & (PIECES * span < self.rest[on])
        column, row = self.cell.take(on, 1)
        state = self.now.state[self.who(on)]
        condition = (row * self.world.labels.shape[1] + column) * len(machine.states) + state
        condition = 4 * condition + self.now.mirror[self.who(on)]
        rounds = in_place & (condition == self.mark[on])
        self.idle = np.where(in_place, self.idle[on] + 1, 0)
        is_power_of_two = (self.idle & (self.idle - 1)) == 0
        self.mark = np.where(is_power_of_two, condition, self.mark[on])
        return rounds & (not machine.chancy)  # a draw may lead out


def _put(into: np.ndarray, some: np.ndarray, values: np.ndarray) -> None:
    """Write values (2, j) to the columns `some` (j,) of `into` (2, k)."""
    for row, value in zip(into, values, strict=True):  # several times faster than into[:, some]
        row[some] = value


def pace_of(
    x: np.ndarray, y: np.ndarray, state: np.ndarray, machine: StateMachine, world: LabelMap
) -> np.ndarray:
    """Return at which of the machine's paces agents walk on, (n,) uint8.

    x, y: (n,) world meters.
    state: (n,) uint8. With the edge policy "stop", agents that stand at the map's border get the
        pace at which their action stands.
    """
    label = world.at(x, y)
    pace = machine.paces.of[state, label]
    if machine.edge == "stop":
        # who stands
        stand = cell_borders.leaves_map(
            np.array((x, y)), machine.velocity[state, label].T, world.area
        )
        pace[stand] = machine.paces.slowest[state[stand]] if len(machine.paces.slowest) else 0
    return pace
