"""The one door to behavior: a crowd one step later (chapter listing 1.1).

`plain_step` takes each agent's step piece by piece. Most steps of most agents are looked up in
tables instead, with the same result to the bit: a step that changes no state and leaves no cell, or
only to a neighbor cell of the same label that shares a side. The agent then reads the table once
and moves once. All others take the plain step: those that change state, draw at random, wait less
than a step, or reach another label or the border of the map. Callers do not choose.

After the step, agents whose new state plays another action begin to fade into it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.paces import FADE_STEPS
from ..crowd.state_machine import StateMachine
from ..errors import CrowdError
from ..world.maps import LabelMap
from .cell_borders import same_beside
from .plain_step import advance

# A step may cross this many cells; one that would cross more is refused, it would seem to hang.
MOST_CELLS = 65_536
# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW_AGENTS = 3000


def courant(machine: StateMachine, world: LabelMap, seconds: float) -> np.ndarray:
    """Return the cell borders crossed in `seconds`, (S, L) float64: state, label.

    Borders along x and y are added.
    """
    with np.errstate(over="ignore"):
        return np.abs(machine.velocity / np.array(world.cell)).sum(axis=2) * seconds


def check_speeds(machine: StateMachine, world: LabelMap, seconds: float) -> None:
    """Raise CrowdError if the table moves more than MOST_CELLS cells in `seconds`.

    The error names the state and the label.
    """
    cells = courant(machine, world, seconds)
    s, label = np.unravel_index(cells.argmax(), cells.shape)
    if not cells[s, label] <= MOST_CELLS:
        raise CrowdError(
            f"The state machine {machine.name} moves {cells[s, label]:.3g} cells of the map in "
            f"one step of {seconds:.3g} s "
            f"in the state {machine.states[s]!r} on {machine.labels[label]!r}; {MOST_CELLS} are "
            f"allowed: give it a lower "
            "speed, or the map fewer pixels."
        )


# Agents a block: its columns stay in the processor's cache.
BLOCK = 16_384
# The signs of the velocity along x and y for each value of Crowd.mirror.
MIRRORED = np.array([(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])


class Tables:
    """The result of one step of `seconds` in each case (mirror, state, label).

    Each table is (cases,), in the order mirror, state, label.

    x, y: displacement, meters; x is NaN where the state changes.
    heading: float32 radians.
    turns, stands: bool, speed above 0, speed 0.
    changing: names of the Crowd columns that a step within a cell changes.
    number: the least type that holds a case.
    """

    def __init__(self, machine: StateMachine, seconds: float):
        self.seconds = seconds
        velocity = machine.velocity[None]
        self.mirrors = machine.edge == "reflect"
        if self.mirrors:
            velocity = velocity * MIRRORED[:, None, None]
        vx, vy = velocity.reshape(-1, 2).T
        speed = np.hypot(vx, vy)
        self.x = vx * seconds
        self.y = vy * seconds
        self.turns = speed > 0
        self.stands = speed == 0
        self.heading = np.arctan2(vy, vx).astype(np.float32)
        states = np.arange(len(machine.states))[:, None]
        changes = (machine.next_state != states) | (machine.next_choice >= 0)
        # NaN is in no cell: one comparison finds all agents that need a plain step
        self.x[np.broadcast_to(changes, velocity.shape[:-1]).ravel()] = np.nan
        is_changing = {"x": self.x.any(), "y": self.y.any(), "wait": machine.timed}
        self.changing = [name for name, changing in is_changing.items() if changing]
        self.labels = len(machine.labels)
        self.rules = machine.next_state.size
        self.number = np.min_scalar_type(len(self.x))

    def cases(self, crowd: Crowd, block: slice, label: np.ndarray) -> np.ndarray:
        """Return the cases (b,) intp of the agents in `block`, with the labels (b,)."""
        case = np.multiply(crowd.state[block], self.labels, dtype=self.number)
        if self.mirrors:
            case += np.multiply(crowd.mirror[block], self.rules, dtype=self.number)
        case += label
        return case.astype(np.intp)


class _Axis(NamedTuple):
    """x or y of a step of n agents.

    old, new: (n,) meters, before and after the step; `new` is written to.
    way: (cases,) meters, of Tables.
    low, high: meters, the map's borders.
    size: meters, of a cell.
    cell_count: of the map's cells.
    """

    old: np.ndarray
    new: np.ndarray
    way: np.ndarray
    low: float
    high: float
    size: float
    cell_count: int

    def holds(self, block: slice) -> bool:
        """Whether all of a block are on the map, and none is at NaN."""
        old = self.old[block]
        return bool(self.low <= old.min() and old.max() <= self.high)

    def cells(self, block: slice) -> np.ndarray:
        """Return the column or row of the cells (b,) float64 of a block on the map."""
        cell = np.floor((self.old[block] - self.low) / self.size)
        # at the map's end, or so near that the quotient rounds up to it
        if cell.max() >= self.cell_count:
            np.minimum(cell, self.cell_count - 1, out=cell)
        return cell


def step_within_cells(
    crowd: Crowd, machine: StateMachine, world: LabelMap, tables: Tables
) -> tuple[Crowd, np.ndarray]:
    """Return (crowd, plain_agents): the crowd one step of the `tables` later.

    plain_agents: (m,) intp, increasing, the agents that need the plain step; their values in the
        crowd are not valid.

    Columns that the step does not change are those of `crowd`.
    """
    area = world.area
    rows, columns = world.labels.shape
    width, depth = world.cell
    moved = replace(
        crowd,
        x=np.empty_like(crowd.x),
        y=np.empty_like(crowd.y),
        heading=np.empty_like(crowd.heading) if tables.turns.any() else crowd.heading,
        wait=np.empty_like(crowd.wait) if machine.timed else crowd.wait,
    )
    axes = (
        _Axis(crowd.x, moved.x, tables.x, area.x_min, area.x_max, width, columns),
        _Axis(crowd.y, moved.y, tables.y, area.y_min, area.y_max, depth, rows),
    )
    plain_agents = [np.empty(0, np.intp)]
    for start in range(0, len(crowd), BLOCK):
        block = slice(start, min(start + BLOCK, len(crowd)))
        if not all(axis.holds(block) for axis in axes):
            plain_agents.append(np.arange(block.start, block.stop))
            continue
        cells = [axis.cells(block) for axis in axes]
        case = tables.cases(crowd, block, _labels(world, cells))
        needs_plain = _move(block, axes, cells, case, machine.edge, world)
        if machine.timed:
            waits = crowd.wait[block]
            needs_plain |= waits < tables.seconds
            np.subtract(waits, tables.seconds, out=moved.wait[block])
        if moved.heading is not crowd.heading:
            _turn(crowd.heading[block], tables, case, moved.heading[block])
        plain_agents.append(np.flatnonzero(needs_plain) + start)
    return moved, np.concatenate(plain_agents)


def merge_columns(
    moved: Crowd, crowd: Crowd, agents: np.ndarray, way: Callable[[Crowd], Crowd]
) -> Crowd:
    """Return `moved`, where `agents` (m,) get the result of `way` applied to `crowd`.

    Writes into those columns of `moved` that it does not share with `crowd`.
    """
    if not len(agents):
        return moved
    before = crowd.of(agents)
    after = way(before)
    columns = {}
    for name, column in moved.columns.items():
        values = getattr(after, name)
        is_shared = column is getattr(crowd, name)
        if is_shared and values.tobytes() == getattr(before, name).tobytes():
            continue
        columns[name] = column.copy() if is_shared else column
        columns[name][agents] = values
    return replace(moved, **columns)


def _labels(world: LabelMap, cells: list[np.ndarray]) -> np.ndarray:
    """Return the labels (b,) of these columns and rows."""
    column, row = cells
    cell = (row * world.labels.shape[1] + column).astype(np.intp)
    return world.labels.ravel().take(cell, mode="clip")


def _move(
    block: slice,
    axes: tuple[_Axis, ...],
    cells: list[np.ndarray],
    case: np.ndarray,
    edge: str,
    world: LabelMap,
) -> np.ndarray:
    """Walk a block of agents; return which of them (b,) bool need the plain step instead.

    cells: column and row of the cells that they are in.
    case: (b,) of Tables.
    """
    needs_plain = np.zeros(len(case), bool)
    leaves = np.zeros(len(case), bool)
    for axis, cell in zip(axes, cells, strict=True):
        old = axis.old[block]
        to = np.add(old, axis.way.take(case, mode="clip"), out=axis.new[block])
        if not (axis.low <= to.min() and to.max() <= axis.high):
            if edge == "clamp":
                np.clip(to, axis.low, axis.high, out=to)
            else:
                needs_plain |= (to < axis.low) | (to > axis.high)
        leaves |= np.floor((to - axis.low) / axis.size) != cell
        if edge == "stop":  # agents that stand on the map's border do not head out
            needs_plain |= (old <= axis.low) | (old >= axis.high)
    if leaves.any():
        x, y = (axis.new[block] for axis in axes)
        leaving = np.flatnonzero(leaves & ~needs_plain)
        leaving = leaving[~np.isnan(x[leaving])]  # their state changes
        to_cell = np.array(world.cells(x[leaving], y[leaving]))
        cell = np.array([index[leaving] for index in cells], np.intp)
        leaves[leaving] = ~same_beside(cell, to_cell, world)
        needs_plain |= leaves
    return needs_plain


def _turn(old: np.ndarray, tables: Tables, case: np.ndarray, new: np.ndarray) -> None:
    """Write the headings (b,) after the step to `new`; who stands keeps the `old` one."""
    tables.heading.take(case, mode="clip", out=new)
    if not tables.turns.all():
        stands = np.flatnonzero(tables.stands.take(case, mode="clip"))
        new[stands] = old[stands]


# Part of a cross-fade by which a step begins early: shares add up with rounding.
EARLY = 1e-4


def fade(before: Crowd, after: Crowd, machine: StateMachine, seconds: float) -> Crowd:
    """Return the crowd `after` with the paces that its agents show.

    before: the crowd `seconds` earlier, with the paces that it showed then.
    after: the crowd after a step of behavior. An agent whose new state plays another action begins
        to fade into it, in the middle of the step. The fade lasts as long as the state's `fade`,
        and the new action's weight rises in FADE_STEPS steps. Where a fade is interrupted, the next
        one begins with the action that weighs more, if there is such a fade.
    """
    if before.played is None or before.faded is None:
        return after
    is_fading = before.faded < 1
    if after.pace is before.pace and not is_fading.any():
        return after
    paces = machine.paces
    played = after.pace.copy()
    faded = np.ones_like(before.faded)

    agents = np.flatnonzero(is_fading)
    share = before.faded[agents] + _share_of(machine.fading, after, agents, seconds)
    _show(played, faded, agents, paces.first_step(before.played[agents]), share)

    agents = np.flatnonzero(paces.action[after.pace] != paces.action[before.pace])
    played[agents] = after.pace[agents]
    faded[agents] = 1
    first = np.asarray(paces.fades)[before.played[agents], after.pace[agents]]
    begins = first >= 0
    agents = agents[begins]
    share = _share_of(machine.fade, after, agents, seconds / 2)
    _show(played, faded, agents, first[begins], share)
    return replace(after, played=played, faded=faded)


def _share_of(length: np.ndarray, crowd: Crowd, agents: np.ndarray, seconds: float) -> np.ndarray:
    """Return the part of their cross-fades, (k,) float32, that `seconds` are.

    length: (S,) seconds of a cross-fade in each state. The part is inf where it is 0.
    agents: (k,) intp.
    """
    with np.errstate(divide="ignore"):
        return (seconds / length[crowd.state[agents]]).astype(np.float32)


def _show(
    played: np.ndarray, faded: np.ndarray, agents: np.ndarray, first: np.ndarray, share: np.ndarray
) -> None:
    """Write to `played` and `faded` what agents show whose cross-fades go on.

    agents: (k,) intp.
    first: (k,) the first step of each one's cross-fade.
    share: (k,) float32, the part of it that is over; from 1 on it has ended.
    """
    goes_on = share < 1 - EARLY
    agents = agents[goes_on]
    share = share[goes_on]
    faded[agents] = share
    played[agents] = first[goes_on] + ((share + EARLY) * FADE_STEPS).astype(np.intp)


def step(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd `seconds` later, in one step.

    At the map's edge the machine's policy decides: `clamp` slides along it, `stop` stands, `wrap`
    goes on at the other side, `reflect` goes on mirrored until the state changes.

    Raises CrowdError if the table moves more than MOST_CELLS cells in `seconds`.
    """
    check_speeds(machine, world, seconds)
    plain = partial(_step_plainly, machine=machine, world=world, seconds=seconds)
    if len(crowd) < FEW_AGENTS:
        moved = plain(crowd)
    else:
        tables = Tables(machine, seconds)
        moved, plain_agents = step_within_cells(crowd, machine, world, tables)
        moved = merge_columns(moved, crowd, plain_agents, plain)
    return fade(crowd, moved, machine, seconds)


def _step_plainly(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    return advance(crowd, machine, world, seconds)[0]
