"""One step of behavior, piece by piece: listing 1.1 on the label map, cut at the cell borders.

An agent reads the label under it. Its old state and that label give both its next state and its
velocity. It moves. A step that stays in one cell is exactly this. So is a step into a neighbor cell
that shares a side and has the same label.

Every other step that would leave the cell is cut at the cell's border (Amanatides and Woo 1987).
Each piece is the listing again, with the label of the cell just entered. So no cell on an agent's
way goes unread, at any speed. Where both borders are reached at once, the border in x is crossed
first: the way leads through the sides of cells, never through a corner, and passes no wall, not
even one whose cells touch only at their corners. A timer that ends within a step cuts it too.

The cost of a step is bounded. Cells of one label are passed at once. An agent that takes more
pieces than PIECES allows is stuck, in a corner between walls, say: it stands until the step ends.
So does an agent that the table leads round and round in place.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..progress import check_cancelled
from ..world.maps import LabelMap
from . import cell_borders
from .cell_borders import Walkers

# Pieces that an agent may take in a step, and those that it gains for each cell that it walks. It
# never has more than PIECES left.
PIECES = 64
PIECES_A_CELL = 8


@dataclass(frozen=True)
class Tally:
    """The cost of one `advance`.

    reads: table reads, summed over all agents.
    stuck: (n,) bool, agents that stood for the rest of the step.
    pieces: pieces of the agent that took most.
    """

    reads: int
    stuck: np.ndarray
    pieces: int


def advance(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    exact: bool = False,
) -> tuple[Crowd, Tally]:
    """Return (crowd, Tally) `seconds` later, every agent stepped piece by piece.

    exact: take the limit of ever shorter steps. An agent whose state changes then moves no further
        than out of the cell on whose border it stands, and reads the table again
        (behavior/exact_walk.py).
    """
    way = _Way(crowd, machine, world, seconds, exact)
    while len(way.rest):
        check_cancelled()
        way.go()
    moved = way.now
    moved.pace[:] = look_up_paces(moved.x, moved.y, moved.state, machine, world)
    return moved, Tally(way.reads, way.stuck, way.pieces)


def look_up_paces(
    x: np.ndarray, y: np.ndarray, state: np.ndarray, machine: StateMachine, world: LabelMap
) -> np.ndarray:
    """Return the index of each agent's pace, (n,) uint8.

    x, y: (n,) world meters.
    state: (n,) uint8. With the edge policy "stop", agents that stand at the map's border get the
        pace at which their action stands.
    """
    label = world.at(x, y)
    pace = machine.paces.of[state, label]
    if machine.edge == "stop":
        velocity = machine.velocity[state, label].T
        stand = cell_borders.leaves_map(np.array((x, y)), velocity, world.area)
        slowest = machine.paces.slowest
        pace[stand] = slowest[state[stand]] if len(slowest) else 0
    return pace


@dataclass
class _Piece:
    """One read of the table and one move of the k agents on their way.

    walkers: where they are, and the velocity that they read.
    label: (k,) uint8, of the cells they are in.
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

    now: the crowd, updated in place.
    agents: which of the crowd's n agents are still on their way: k indices, or at first all.
    cell: (2, k) intp, column and row of the cells they are in.
    rest: (k,) seconds they have left.
    pieces_left: (k,) the pieces that each of them may still take.
    pieces_in_place: (k,) intp, how many of each one's last pieces have led nowhere.
    mark: (k,) intp, the condition of each that _go_in_rounds compares with.
    stuck, reads, pieces: see Tally.
    """

    def __init__(
        self,
        crowd: Crowd,
        machine: StateMachine,
        world: LabelMap,
        seconds: float,
        exact: bool,
    ):
        self.machine = machine
        self.world = world
        self.exact = exact
        self.draws = machine.timed or machine.chancy
        self.reflects = machine.edge == "reflect"
        area = world.area
        self.now = replace(
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
        self.cell = np.array(world.cells(self.now.x, self.now.y))
        self.rest = np.full(len(crowd), float(seconds))
        # an agent that does not get on sees at most the 4 cells round a corner, in each state:
        # after more pieces than that it has met one of them twice
        self.patience = max(PIECES, 4 * len(machine.states) + 4) if exact else PIECES
        self.pieces_left = np.full(len(crowd), float(self.patience))
        self.pieces_in_place = np.zeros(len(crowd), np.intp)
        self.mark = np.full(len(crowd), -1)
        self.stuck = np.zeros(len(crowd), bool)
        self.reads = 0
        self.pieces = 0
        self.cell_size = np.array(world.cell)[:, None]
        # (2, states x labels): NumPy is several times faster along rows than across pairs
        self.velocities = np.ascontiguousarray(machine.velocity.reshape(-1, 2).T)

    def go(self) -> None:
        """Take all who are on their way one piece further."""
        if self.machine.timed:
            self._end_timers()
        piece = self._aim(*self._read())
        if len(piece.leaves) and not self.exact:
            self._enter_alike(piece)
        if len(piece.leaves):
            self._stop_at_border(piece)
        self._move(piece)
        self._go_on(piece)

    def indices(self, walking: np.ndarray) -> np.ndarray:
        """Return the crowd's indices of `walking`, (j,) intp indices of those on their way."""
        return walking if isinstance(self.agents, slice) else self.agents[walking]

    def _end_timers(self) -> None:
        """Move those whose timer has run out into their next state."""
        now = self.now
        machine = self.machine
        ended = self.indices(np.flatnonzero(now.wait[self.agents] <= 0))
        now.state[ended] = machine.timed_out(now.state[ended], now.key[ended])
        now.key[ended] = random_streams.advance_keys(now.key[ended], np.ones(len(ended), bool))
        now.wait[ended] = machine.waits(now.state[ended], now.key[ended])

    def _read(self) -> tuple[Walkers, np.ndarray, np.ndarray]:
        """Read the table: the old state and the label give the velocity and the next state.

        Returns walkers, label and changed, as in _Piece.
        """
        now = self.now
        machine = self.machine
        agents = self.agents
        column, row = self.cell
        label = self.world.labels[row, column]
        old = now.state[agents]
        rule = old.astype(np.intp) * len(machine.labels) + label
        velocity = self.velocities.take(rule, axis=1)
        new = machine.following(old, label, now.key[agents])
        changed = new != old
        now.state[agents] = new
        if self.reflects:
            mirror = now.mirror[agents]
            velocity = velocity * np.stack([1.0 - 2 * (mirror & 1), 1.0 - (mirror & 2)])
            now.mirror[agents] *= ~changed
        if self.draws:
            now.key[agents] = random_streams.advance_keys(now.key[agents], changed)
            entrants = self.indices(np.flatnonzero(changed))
            now.wait[entrants] = machine.waits(now.state[entrants], now.key[entrants])
        place = np.array((now.x[agents], now.y[agents]))
        if machine.edge == "stop":
            velocity[:, cell_borders.leaves_map(place, velocity, self.world.area)] = 0
        return Walkers(place, self.cell, velocity), label, changed

    def _aim(self, walkers: Walkers, label: np.ndarray, changed: np.ndarray) -> _Piece:
        """Return the piece up to the end of the step or of a timer, through any border."""
        world = self.world
        edge = self.machine.edge
        span = self.rest.copy()
        if self.machine.timed:
            np.minimum(span, self.now.wait[self.agents], out=span)
        if self.exact:
            span[changed] = 0
        to = walkers.place + walkers.velocity * span
        to_cell = np.array(world.cells(*to))
        leaves = (to_cell != walkers.cell).any(axis=0)
        if edge != "clamp":
            leaves |= cell_borders.outside(to, world.area)
        if self.exact or self.pieces:
            # on a border and heading out: however short the move, even if rounding loses it, it
            # leaves the cell
            leaves |= cell_borders.on_border(walkers, world, edge)
        border = np.flatnonzero(leaves)
        reads = np.ones(len(span), np.intp)
        return _Piece(walkers, label, changed, span, to, to_cell, border, reads)

    def _enter_alike(self, piece: _Piece) -> None:
        """Let agents go on that enter a cell of the same label at their side: no read is needed."""
        world = self.world
        leaving = piece.leaves
        to_cell = piece.to_cell.take(leaving, 1)
        alike = cell_borders.same_beside(self.cell.take(leaving, 1), to_cell, world)
        alike &= ~piece.changed[leaving]
        if self.machine.edge != "clamp":
            alike &= ~cell_borders.outside(piece.to.take(leaving, 1), world.area)
        entrants = leaving[alike]
        _put(self.cell, entrants, to_cell[:, alike])
        piece.reads[entrants] += 1
        piece.leaves = leaving[~alike]

    def _stop_at_border(self, piece: _Piece) -> None:
        """Stop agents that leave their cell at its border, or at the end of cells of one label."""
        now = self.now
        world = self.world
        leaving = piece.leaves
        walkers = piece.walkers.of(leaving)
        span = piece.span[leaving]
        ahead = ~piece.changed[leaving] * cell_borders.count_cells_ahead(walkers, span, world)
        crossing = cell_borders.to_border(walkers, span, ahead, world, self.machine.edge)
        _put(piece.to, leaving, crossing.place)
        _put(self.cell, leaving, crossing.cell)
        piece.span[leaving] = crossing.seconds
        piece.reads[leaving] += crossing.crossed
        if self.reflects:
            now.mirror[self.indices(leaving)] ^= crossing.flips
        if self.draws:
            column, row = crossing.cell
            entered = np.zeros(len(piece.span), bool)
            entered[leaving] = world.labels[row, column] != piece.label[leaving]
            now.key[self.agents] = random_streams.advance_keys(now.key[self.agents], entered)

    def _move(self, piece: _Piece) -> None:
        """Walk the piece."""
        now = self.now
        agents = self.agents
        area = self.world.area
        x, y = piece.to
        now.x[agents] = np.clip(x, area.x_min, area.x_max)
        now.y[agents] = np.clip(y, area.y_min, area.y_max)
        vx, vy = piece.walkers.velocity
        moves = np.hypot(vx, vy) > 0
        now.heading[agents] = np.where(moves, np.arctan2(vy, vx), now.heading[agents])
        if self.machine.timed:
            now.wait[agents] -= piece.span
        self.rest = self.rest - piece.span
        self.pieces += 1
        self.reads += int(piece.reads.sum())

    def _go_on(self, piece: _Piece) -> None:
        """Keep the agents that have time left and are not stuck."""
        on = np.flatnonzero(self.rest > 0)
        speed = np.abs(piece.walkers.velocity.take(on, 1) / self.cell_size).max(axis=0)
        cells = piece.span[on] * speed
        left = np.minimum(self.pieces_left[on] + PIECES_A_CELL * cells, self.patience) - 1
        stuck = (left <= 0) | self._go_in_rounds(piece, on)
        if stuck.any():
            standing = self.indices(on[stuck])
            self.stuck[standing] = True
            if self.machine.timed:
                self.now.wait[standing] -= self.rest[on[stuck]]
        walks = ~stuck
        on = on[walks]
        self.agents = self.indices(on)
        self.cell = self.cell.take(on, 1)
        self.rest = self.rest[on]
        self.pieces_left = left[walks]
        self.pieces_in_place = self.pieces_in_place[walks]
        self.mark = self.mark[walks]

    def _go_in_rounds(self, piece: _Piece, on: np.ndarray) -> np.ndarray:
        """Return (j,) bool, agents that came back in place to a cell and state they were in.

        The table leads them round and round in next to no time: they never leave the place. Each
        agent's condition is compared with the one it had 1, 2, 4, 8 ... pieces ago (Brent 1980).
        Who goes on at the other side of the map has left the place.

        on: (j,) intp, which of those on their way have time left.
        """
        machine = self.machine
        span = piece.span[on]
        walked = np.abs(piece.walkers.velocity.take(on, 1)).max(axis=0) * span
        moved = np.abs(piece.to.take(on, 1) - piece.walkers.place.take(on, 1)).max(axis=0)
        stays = np.maximum(walked, moved) <= self.world.rounding
        in_place = stays & (PIECES * span < self.rest[on])
        column, row = self.cell.take(on, 1)
        agents = self.indices(on)
        condition = (row * self.world.labels.shape[1] + column) * len(machine.states)
        condition = 4 * (condition + self.now.state[agents]) + self.now.mirror[agents]
        rounds = in_place & (condition == self.mark[on])
        self.pieces_in_place = np.where(in_place, self.pieces_in_place[on] + 1, 0)
        is_power_of_two = (self.pieces_in_place & (self.pieces_in_place - 1)) == 0
        self.mark = np.where(is_power_of_two, condition, self.mark[on])
        return rounds & (not machine.chancy)  # a draw may lead out


def _put(into: np.ndarray, agents: np.ndarray, values: np.ndarray) -> None:
    """Write values (2, j) to the columns `agents` (j,) of `into` (2, k)."""
    for row, value in zip(into, values, strict=True):  # several times faster than into[:, agents]
        row[agents] = value
