"""Steps within a cell, looked up in tables: most steps of most agents.

A step is looked up if it changes no state and leaves no cell, or only to a neighbor cell of the
same label that shares a side. The agent then reads the table once and moves once, and its state and
label give all of the result. The tables are made for the step and applied block by block.

All other agents take the plain step (plain_step.advance), with the same result to the bit: those
that change state, draw at random, wait less than a step, or reach another label or the border of
the map.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap
from .cell_borders import same_beside

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
