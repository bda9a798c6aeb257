"""Steps within a cell, looked up in tables: most steps of most agents.

A step is looked up if it changes no state and leaves no cell, or only to a neighbor cell of the
same label that shares a side. The agent then reads the table once and moves once, and its state and
label give all of the result. The tables are made for the step and applied block by block.

All other agents take the long step (step.advance), with the same result to the bit: those that
change state, draw at random, wait less than a step, or reach another label or the border of the
map.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import ONE_LABEL, LeftOut
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
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
    """

    def __init__(self, machine: StateMachine, seconds: float):
        self.seconds, velocity = seconds, machine.velocity[None]
        if machine.edge == "reflect":
            velocity = velocity * MIRRORED[:, None, None]
        vx, vy = velocity.reshape(-1, 2).T
        speed = np.hypot(vx, vy)
        self.x, self.y = vx * seconds, vy * seconds
        self.turns, self.stands = speed > 0, speed == 0
        self.heading = np.arctan2(vy, vx).astype(np.float32)
        states = np.arange(len(machine.states))[:, None]
        changes = (machine.next_state != states) | (machine.next_choice >= 0)
        # who changes state is in no cell afterwards, so that one comparison finds all who go the
        # long way
        self.x[np.broadcast_to(changes, (len(velocity), *changes.shape)).ravel()] = np.nan
        changing = {"x": self.x.any(), "y": self.y.any(), "wait": machine.timed}
        # columns that a step within a cell changes
        self.changing = [name for name, changes in changing.items() if changes]
        self.labels, self.size, self.mirrors = (
            len(machine.labels),
            machine.next_state.size,
            len(velocity) > 1,
        )
        self.number = np.min_scalar_type(len(self.x))

    def cases(self, crowd: Crowd, block: slice, label: np.ndarray) -> np.ndarray:
        """Return the cases (b,) intp of the agents in `block`; label: (b,) or one."""
        case = np.multiply(crowd.state[block], self.labels, dtype=self.number)
        if self.mirrors:
            case += np.multiply(crowd.mirror[block], self.size, dtype=self.number)
        case += label
        return case.astype(np.intp)


def within(
    crowd: Crowd, machine: StateMachine, world: LabelMap, tables: Tables, leave: frozenset[LeftOut]
) -> tuple[Crowd, np.ndarray]:
    """Return (crowd, rest): the crowd one step of the `tables` later.

    rest: (m,) intp, increasing, the agents that need the long step; their values in the crowd are
        not valid.

    Other arguments as in step.step. Columns that the step does not change are those of `crowd`.
    """
    x, y = np.empty_like(crowd.x), np.empty_like(crowd.y)
    heading = np.empty_like(crowd.heading) if tables.turns.any() else crowd.heading
    wait = np.empty_like(crowd.wait) if machine.timed else crowd.wait
    area, (rows, columns), (width, depth) = world.area, world.labels.shape, world.cell
    sides = (
        (crowd.x, x, tables.x, area.x_min, area.x_max, width, columns),
        (crowd.y, y, tables.y, area.y_min, area.y_max, depth, rows),
    )
    labels = world.labels.ravel()
    rest = []
    for at in range(0, len(x), BLOCK):
        block = slice(at, at + BLOCK)
        if not all(
            low <= old[block].min() and old[block].max() <= high
            for old, _, _, low, high, _, _ in sides
        ):
            rest.append(np.arange(at, min(at + BLOCK, len(x))))  # beyond the map, or at NaN
            continue
        cells = [np.floor((old[block] - low) / size) for old, _, _, low, _, size, _ in sides]
        for (*_, count), cell in zip(sides, cells, strict=True):
            # at the map's end, or so near that the quotient rounds up to it
            if cell.max() >= count:
                np.minimum(cell, count - 1, out=cell)
        one = ONE_LABEL in leave
        label = (
            labels[0]
            if one
            else labels.take((cells[1] * columns + cells[0]).astype(np.intp), mode="clip")
        )
        case = tables.cases(crowd, block, label)
        other, leaves = np.zeros((2, len(case)), bool)
        for (old, new, way, low, high, size, _), cell in zip(sides, cells, strict=True):
            to = np.add(old[block], way.take(case, mode="clip"), out=new[block])
            if not (low <= to.min() and to.max() <= high):
                if machine.edge == "clamp":
                    np.clip(to, low, high, out=to)
                else:
                    other |= (to < low) | (to > high)
            leaves |= np.floor((to - low) / size) != cell
        if machine.edge == "stop":  # who stands on the map's border does not head out
            for old, _, _, low, high, _, _ in sides:
                other |= (old[block] <= low) | (old[block] >= high)
        if machine.timed:
            waits = crowd.wait[block]
            other |= waits < tables.seconds
            np.subtract(waits, tables.seconds, out=wait[block])
        if leaves.any():
            c = np.flatnonzero(leaves & ~other)
            c = c[~np.isnan(x[block][c])]  # their state changes
            to_cell = np.array(world.cells(x[block][c], y[block][c]))
            leaves[c] = ~same_beside(np.array([cell[c] for cell in cells], np.intp), to_cell, world)
            other |= leaves
        if heading is not crowd.heading:
            _turn(crowd.heading[block], tables, case, heading[block])
        rest.append(np.flatnonzero(other) + at)
    moved = replace(crowd, x=x, y=y, heading=heading, wait=wait)
    return moved, np.concatenate(rest) if rest else np.empty(0, np.intp)


def mended(moved: Crowd, crowd: Crowd, agents: np.ndarray, way: Callable[[Crowd], Crowd]) -> Crowd:
    """Return `moved`, where `agents` (m,) get the result of `way` applied to `crowd`.

    Writes into those columns of `moved` that it does not share with `crowd`.
    """
    if not len(agents):
        return moved
    taken = crowd.of(agents)
    other, columns = way(taken), {}
    for name, column in moved.columns.items():
        own, before = getattr(other, name), getattr(crowd, name)
        if column is not before or own.tobytes() != getattr(taken, name).tobytes():
            columns[name] = column.copy() if column is before else column
            columns[name][agents] = own
    return replace(moved, **columns)


def _turn(old: np.ndarray, tables: Tables, case: np.ndarray, new: np.ndarray) -> None:
    tables.heading.take(case, mode="clip", out=new)
    if not tables.turns.all():
        stands = np.flatnonzero(tables.stands.take(case, mode="clip"))
        new[stands] = old[stands]
