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

The cost of a step is bounded. Cells of one label are passed at once. An agent that returns to an
earlier state skips whole rounds. An agent that turns ever more often without getting anywhere
stands until the step ends (cell_borders.Rounds).
"""

from dataclasses import dataclass, replace

import numpy as np

from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.leave_outs import NOTHING, ONE_LABEL, ONE_PACE, UNCHANGING, LeftOut
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from ..progress import breath
from . import cell_borders
from .courant_number import check_speeds
from .tabulated_step import Tables, mended, within

# An agent that crosses HOLD borders in a row without progress is sent to and fro by the table; it
# stands until the step ends. (In a dead end random turns need several.)
HOLD = 32
# Times as many pieces of its way has an agent in a step, and about as many more for each cell that
# it walks: it is caught where walls leave it next to no room, as those do that touch at a corner,
# and if it does not go to and fro in equal rounds it stands.
MOST_TURNS = 8
# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW_AGENTS = 3000


@dataclass(frozen=True)
class Tally:
    """The cost of one `advance`.

    reads: table reads, summed over all agents.
    held: (n,) bool, agents that the table sent to and fro with no progress, or nearly none. They
        may have stood for part of the step.
    pieces: pieces of the agent that took most, without those skipped in whole rounds.
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
    return mended(moved, crowd, rest, lambda some: advance(some, machine, world, seconds, leave=leave)[0])


def advance(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float, exact=False, leave=NOTHING):
    """Return (crowd, Tally) `seconds` later, every agent stepped piece by piece.

    exact: take the limit of ever shorter steps. An agent whose state changes then moves no further
        than out of the cell on whose border it stands, and reads the table again
        (behaviour/exact_walk.py).
    leave: parts to leave out, from leave_outs.needless.
    """
    area = world.area
    x, y = np.clip(crowd.x, area.x_min, area.x_max), np.clip(crowd.y, area.y_min, area.y_max)
    heading, state = crowd.heading.copy(), crowd.state.copy()
    wait, key, mirror = crowd.wait.copy(), crowd.key, crowd.mirror
    draws, reflects = machine.timed or machine.chancy, machine.edge == "reflect"
    key = key.copy() if draws else key
    mirror = mirror.copy() if reflects else mirror
    # in a zero-time run an agent sees at most the 4 cells round a corner in each state: if it goes
    # on, it has met one twice
    patience = 4 * len(machine.states) + 4 if exact else HOLD
    held, reads = np.zeros(len(x), bool), 0
    # without chance, timers, and mirrors, who comes back to where it was goes on in rounds
    repeats, met = not (exact or draws or reflects), None
    rounds, pieces = cell_borders.Rounds(MOST_TURNS * patience, area), 0
    agents = slice(None)  # those still on the move; their own arrays follow
    column, row = world.cells(x, y)
    rest, idle = np.full(len(x), float(seconds)), np.zeros(len(x), np.int32)
    # NumPy is several times faster along rows than across pairs
    table = np.ascontiguousarray(machine.velocity.reshape(-1, 2).T)
    cell = np.array(world.cell)[:, None]
    timed = machine.timed
    while len(rest):
        breath()
        if timed:
            _time_out(machine, agents, state, wait, key)
        old = state[agents]
        label = world.labels[:1, 0] if ONE_LABEL in leave else world.labels[row, column]
        velocity = table.take(old.astype(np.intp) * len(machine.labels) + label, axis=1)
        if UNCHANGING in leave:
            changed = np.zeros(len(rest), bool)
        else:
            new = machine.following(old, label, key[agents])
            changed = new != old
            state[agents] = new
        read = np.ones(len(rest), np.intp)
        if reflects:
            velocity = velocity * np.stack([1.0 - 2 * (mirror[agents] & 1), 1.0 - (mirror[agents] & 2)])
            mirror[agents] *= ~changed
        if draws:
            key[agents] = random_streams.moved_on(key[agents], changed)
            into = np.flatnonzero(changed) if isinstance(agents, slice) else agents[changed]
            wait[into] = machine.waits(state[into], key[into])
        if machine.edge == "stop":
            velocity[:, cell_borders.leaves_map(x[agents], y[agents], velocity, area)] = 0
        span = np.minimum(rest, wait[agents]) if timed else rest.copy()
        if exact:
            span[changed] = 0
        # where the span leads; those who would leave their cell go to its border
        to_x, to_y = x[agents] + velocity[0] * span, y[agents] + velocity[1] * span
        to_column, to_row = world.cells(to_x, to_y)
        leaves = (to_column != column) | (to_row != row)
        if machine.edge != "clamp":
            leaves |= cell_borders.outside(to_x, to_y, area)
        if exact or not isinstance(agents, slice):
            # on a border and heading out: however short the move, even if rounding loses it, it
            # leaves the cell
            leaves |= cell_borders.on_border(x[agents], y[agents], column, row, velocity, world, machine.edge)
        c = np.flatnonzero(leaves)
        # into a cell of the same label at its side nothing is read that is not known
        if len(c) and not exact:
            on = c[cell_borders.same_beside(column[c], row[c], to_column[c], to_row[c], world) & ~changed[c]]
            if machine.edge != "clamp":
                on = on[~cell_borders.outside(to_x[on], to_y[on], area)]
            column[on], row[on], leaves[on] = to_column[on], to_row[on], False
            read[on] += 1
            c = np.flatnonzero(leaves)
        if len(c):
            past = ~changed[c] * cell_borders.past(column[c], row[c], velocity[:, c], span[c], world)
            at = x[agents][c], y[agents][c], column[c], row[c], velocity[:, c], span[c]
            span[c], to_x[c], to_y[c], column[c], row[c], flips, crossed = cell_borders.to_border(*at, world, machine.edge, past)
            read[c] += crossed
            if reflects:
                mirror[np.arange(len(x))[agents][c]] ^= flips
            if draws:
                entered = np.zeros(len(rest), bool)
                entered[c] = ONE_LABEL not in leave and world.labels[row[c], column[c]] != label[c]
                key[agents] = random_streams.moved_on(key[agents], entered)
        x[agents] = np.clip(to_x, area.x_min, area.x_max)
        y[agents] = np.clip(to_y, area.y_min, area.y_max)
        speed = np.hypot(*velocity)
        heading[agents] = np.where(speed > 0, np.arctan2(velocity[1], velocity[0]), heading[agents])
        if timed:
            wait[agents] -= span
        rest = rest - span
        # who goes on, and who has been at it too long without getting anywhere
        j = np.flatnonzero(leaves | changed) if exact else c
        slow = span[j] * np.abs(velocity[:, j] / cell).max(axis=0) <= cell_borders.PROGRESS
        before, idle = idle, np.zeros(len(idle), np.int32)
        if slow.any():
            idle[j] = np.where(slow, before[j] + 1, 0)
            if repeats:
                met = np.full((6, len(x)), np.nan) if met is None else met
                now = np.array([x[agents], y[agents], state[agents], column, row, rest])[:, j]
                skipped = cell_borders.rounds(now, met, np.arange(len(x))[agents][j], idle[j], patience)
                idle[j] += skipped
                reads += int(skipped.sum())
        pieces, reads, stands = pieces + 1, reads + int(read.sum()), False
        if pieces >= cell_borders.MANY_PIECES:
            now = None if draws else np.array([x[agents], y[agents], state[agents], mirror[agents], column, row])
            gone = np.array([span * np.abs(velocity / cell).max(axis=0), read])
            times, took, (_, more), caught, stands = rounds.piece(pieces, now, rest, gone)
            rest = np.maximum(rest - times * took, 0)
            reads += int(times @ more)
            held[agents[caught]] = True
        goes = rest > 0
        gives_up = goes & ((idle >= patience) | stands)
        agents = np.flatnonzero(goes) if isinstance(agents, slice) else agents[goes]
        if gives_up.any():
            stand = agents[gives_up[goes]]
            held[stand] = True
            wait[stand] -= rest[gives_up]
            agents, goes = agents[~gives_up[goes]], goes & ~gives_up
        if pieces >= cell_borders.MANY_PIECES:
            rounds.keep(goes)
        rest, idle, column, row = rest[goes], idle[goes], column[goes], row[goes]
    wait = wait if timed else crowd.wait
    pace = crowd.pace if ONE_PACE in leave else pace_of(x, y, state, machine, world)
    moved = replace(crowd, x=x, y=y, heading=heading, state=state, wait=wait, key=key, mirror=mirror, pace=pace)
    return moved, Tally(reads, held, pieces)


def _time_out(machine: StateMachine, agents, state, wait, key) -> None:
    """Move those of `agents` whose timer has run out into their next state."""
    out = np.flatnonzero(wait <= 0) if isinstance(agents, slice) else agents[wait[agents] <= 0]
    state[out] = machine.timed_out(state[out], key[out])
    key[out] = random_streams.moved_on(key[out], np.ones(len(out), bool))
    wait[out] = machine.waits(state[out], key[out])


def pace_of(x: np.ndarray, y: np.ndarray, state: np.ndarray, machine: StateMachine, world: LabelMap) -> np.ndarray:
    """Return at which of the machine's paces agents walk on, (n,) uint8.

    x, y: (n,) world metres.
    state: (n,) uint8. With the edge policy "stop", agents that stand at the map's border get pace
        0.
    """
    label = world.at(x, y)
    pace = machine.paces.of[state, label]
    if machine.edge == "stop":
        # who stands
        pace[cell_borders.leaves_map(x, y, machine.velocity[state, label].T, world.area)] = 0
    return pace
