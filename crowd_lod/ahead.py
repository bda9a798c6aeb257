"""Steps that need no look at the map: agents that walk straight on, known some steps ahead.

Until an agent comes to the border of its cell, or its timer ends, each step adds the same way to its place, and the same part
of a cycle to its phase. For how many steps that is sure, is worked out once. While they last they are taken for all agents
at once by a few additions, the same as those of behaviour.advance; only who has none left goes the long way.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .agents import Crowd
from .machine import StateMachine
from .maps import LabelMap
from .within import BLOCK, Tables, mended, play

# The most steps that are known ahead.
MOST = 255
# Where more than this part of a crowd takes the long way, it is stepped faster as a whole.
MANY = 0.25
# Spacings of the map's largest coordinate by which a border counts as nearer than it is: far more than MOST roundings of a place.
SLACK = 512


@dataclass(frozen=True)
class Ahead:
    """What is known of a crowd's next steps. case: (n,), what each agent does (within.Tables); steps: (n,) uint8, for how many
    steps of so many `seconds` it surely does that and nothing else."""

    case: np.ndarray
    steps: np.ndarray
    seconds: float


@np.errstate(divide="ignore", invalid="ignore")
def look(crowd: Crowd, machine: StateMachine, world: LabelMap, tables: Tables) -> Ahead:
    """What is known of the crowd's next steps, of those that the `tables` are for."""
    case, steps = np.empty(len(crowd), tables.number), np.empty(len(crowd), np.uint8)
    area, (rows, columns), (width, depth) = world.area, world.labels.shape, world.cell
    sides = (crowd.x, tables.x, area.x_min, width, columns), (crowd.y, tables.y, area.y_min, depth, rows)
    # by less than a cell a step, agents go on through cells of the same label, in one row or in one column of them
    through = np.abs(tables.x) < 0.99 * width, (np.abs(tables.y) < 0.99 * depth) & (tables.x == 0)
    slack = SLACK * np.spacing(np.abs((area.x_min, area.x_max, area.y_min, area.y_max)).max())
    for at in range(0, len(crowd), BLOCK):
        block = slice(at, at + BLOCK)
        cells = [np.floor((old[block] - low) / size) for old, _, low, size, _ in sides]
        at_cell = (cells[1] * columns + cells[0]).astype(np.intp)
        of = tables.cases(crowd, block, world.labels.ravel().take(at_cell, mode="clip"))
        least = np.full(len(of), float(MOST))
        for (old, way, low, size, count), cell, runs, on in zip(sides, cells, world.runs, through, strict=True):
            place, by = old[block], way.take(of)
            room = np.abs(low + (cell + (by > 0)) * size - place) - slack
            room += size * on.take(of) * runs.take((by > 0) * runs.shape[1] + at_cell, mode="clip")
            np.minimum(least, room / np.abs(by), where=by != 0, out=least)
            least[~((cell >= 0) & (cell < count)) | ((place == 0) & np.signbit(place))] = 0  # -0.0 + 0.0 is another
        if machine.timed:
            least = np.minimum(least, crowd.wait[block] / tables.seconds * (1 - 1e-4) - 2)  # it is rounded to float32 each step
        least[tables.turns.take(of) & (tables.heading.take(of) != crowd.heading[block])] = 0
        case[block], steps[block] = of, np.where(least >= 1, least, 0)
    return Ahead(case, steps, tables.seconds)


def onward(
    crowd: Crowd,
    ahead: Ahead,
    machine: StateMachine,
    world: LabelMap,
    tables: Tables,
    way: Callable[[Crowd], Crowd],
) -> tuple[Crowd, Ahead | None]:
    """(crowd, what is known of it then) a step of the `tables` later, which is as long as those that are known `ahead`, or
    shorter: then nothing is known after it. way: makes that step for agents of whom nothing is known."""
    due = np.flatnonzero(ahead.steps == 0)
    if len(due) > MANY * len(crowd):
        return way(crowd), None
    moved, other = mended(_go_on(crowd, ahead, tables), crowd, due, way)
    if tables.seconds != ahead.seconds:
        return moved, None
    case, steps, there = ahead.case.copy(), ahead.steps - np.uint8(1), look(other, machine, world, tables)
    case[due], steps[due] = there.case, there.steps
    return moved, Ahead(case, steps, ahead.seconds)


def _go_on(crowd: Crowd, ahead: Ahead, tables: Tables) -> Crowd:
    """The crowd a step of the `tables` later, right for whom `ahead` knows a step. Columns that stay are those of `crowd`."""
    moved = {name: np.empty_like(getattr(crowd, name)) for name in tables.changing}
    for at in range(0, len(crowd), BLOCK):
        block = slice(at, at + BLOCK)
        case = ahead.case[block].astype(np.intp)
        for name, way in (("x", tables.x), ("y", tables.y)):
            if name in moved:
                np.add(getattr(crowd, name)[block], way.take(case, mode="clip"), out=moved[name][block])
        if "wait" in moved:
            moved["wait"][block] = crowd.wait[block].astype(np.float64) - tables.seconds
        if "phase" in moved:
            play(crowd.phase[block], tables, case, crowd.group[block], moved["phase"][block])
    return replace(crowd, **moved)
