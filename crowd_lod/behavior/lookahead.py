"""Steps without a look at the map, for agents known to walk straight on.

Until an agent reaches another label, a corner of cells, or the end of its timer, each step adds the
same displacement to its position. The number of such steps is computed once. While it lasts, a few
additions step all agents at once, with the results of step.advance.

When an agent's known steps end, it is looked at again. An agent that only enters the next cell of
its label goes on; every other one takes the long step (step.advance). Agents do not look at each
other, so the long steps of several coming frames, each agent's at its own time, are computed
together and kept until their frames: the calls of such a step cost more than its agents.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import NOTHING
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from .tabulated_step import BLOCK, Tables, mended, within

# The most steps that are known ahead.
MOST = 4095
# Steps whose long ones are made together: the most of which no more than this part of the crowd
# makes one.
TOGETHER, FEW = (16, 4), 1 / 16
# Borders along x that agents who walk aslant are followed across, at most.
CROSSED = 4
# Long steps of an agent that are made together, at most.
ROUNDS = 6
# Where more than this part of a crowd makes a long step at a time, it is stepped faster as a whole.
MANY = 0.25
# Spacings of the map's largest coordinate by which a border counts as nearer than it is: more than
# MOST roundings of a place.
SLACK = 8192
# Part of a timer by which it counts as shorter than it is: more than MOST roundings to float64.
TICK = 1e-12


@dataclass(frozen=True)
class Turn:
    """The long steps of one frame.

    agents: (m,) intp, the agents that make one.
    after: column name -> (m,) values after the step, for the columns of Crowd that change.
    case: (m,), the case of Tables that each agent follows from then on.
    """

    agents: np.ndarray
    after: dict[str, np.ndarray]
    case: np.ndarray


NOBODY = Turn(np.empty(0, np.intp), {}, np.empty(0, np.intp))


@dataclass(frozen=True)
class Ahead:
    """What is known of a crowd's next steps.

    case: (n,), each agent's case, an index into Tables.
    steps: (n,) uint16, for how many steps after those of `turns` the agent surely does this and
        nothing else.
    seconds: the length of a step.
    turns: the long steps of the next frames, one Turn a frame.
    """

    case: np.ndarray
    steps: np.ndarray
    seconds: float
    turns: tuple[Turn, ...] = ()


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def look(crowd: Crowd, machine: StateMachine, world: LabelMap, tables: Tables) -> Ahead:
    """Return what is known of the crowd's next steps, as long as that of `tables`."""
    case, steps = np.empty(len(crowd), tables.number), np.empty(len(crowd), np.uint16)
    area, (rows, columns), (width, depth) = world.area, world.labels.shape, world.cell
    sides = (
        (crowd.x, tables.x, area.x_min, width, columns),
        (crowd.y, tables.y, area.y_min, depth, rows),
    )
    # by less than a cell a step, agents go on through cells of the same label, in one row or in one
    # column of them
    across, up, aside = (
        np.abs(tables.x) < 0.99 * width,
        np.abs(tables.y) < 0.99 * depth,
        tables.x != 0,
    )
    through, slanting = (across, up & ~aside), across & up & aside & (tables.y != 0)
    heading = tables.heading.view(np.int32)  # 0.0 and -0.0 are two
    slack = SLACK * np.spacing(np.abs((area.x_min, area.x_max, area.y_min, area.y_max)).max())
    for at in range(0, len(crowd), BLOCK):
        block = slice(at, at + BLOCK)
        cells = [np.floor((old[block] - low) / size) for old, _, low, size, _ in sides]
        at_cell = (cells[1] * columns + cells[0]).astype(np.intp)
        of = tables.cases(crowd, block, world.labels.ravel().take(at_cell, mode="clip"))
        least, bad, rooms = np.full(len(of), float(MOST)), np.zeros(len(of), bool), []
        for (old, way, low, size, count), cell, runs, on in zip(
            sides, cells, world.runs, through, strict=True
        ):
            place, by = old[block], way.take(of)
            rooms.append(np.abs(low + (cell + (by > 0)) * size - place) - slack)
            room = rooms[-1] + size * on.take(of) * runs.take(
                (by > 0) * runs.shape[1] + at_cell, mode="clip"
            )
            np.minimum(least, room / np.abs(by), where=by != 0, out=least)
            # -0.0 + 0.0 is another
            bad |= ~((cell >= 0) & (cell < count)) | ((place == 0) & np.signbit(place))
        some = slanting.take(of).nonzero()[0]
        if len(some):
            ways = np.array([tables.x, tables.y])[:, of[some]]
            known = _across(np.array(rooms)[:, some], ways, at_cell[some], world, slack)
            least[some] = np.maximum(least[some], known)
        least[bad] = 0
        if machine.timed:
            least = np.minimum(least, crowd.wait[block] / tables.seconds * (1 - TICK) - 2)
        turned = heading.take(of) != crowd.heading[block].view(np.int32)
        least[tables.turns.take(of) & turned] = 0
        case[block], steps[block] = of, np.where(least >= 1, least, 0)
    return Ahead(case, steps, tables.seconds)


def _across(
    rooms: np.ndarray, ways: np.ndarray, at_cell: np.ndarray, world: LabelMap, slack: float
) -> np.ndarray:
    """Return for how many steps agents that walk aslant stay in their label, (m,).

    In these steps no agent goes through a corner of cells. Both borders are crossed in one step
    only where an agent reaches them less than a step apart.

    rooms: (2, m) meters to the borders ahead, along x and y.
    ways: (2, m) meters of a step.
    at_cell: (m,) indices into the flat map.
    slack: meters by which a border counts as nearer.
    """
    (width, depth), pace = world.cell, np.abs(ways)
    square = (
        world.squares.reshape(-1).take(
            (2 * (ways[1] > 0) + (ways[0] > 0)) * world.labels.size + at_cell, mode="clip"
        )
        - 1.0
    )
    until = (rooms + square * np.array([[width], [depth]])) / pace
    known, (across, up) = np.minimum(until[0], until[1]), rooms / pace
    apart, beside = np.array([[width], [depth]]) / pace
    near = 1.01 + 2 * slack * (1 / pace).sum(axis=0)
    for _ in range(CROSSED):
        since = (up - across) / apart
        since -= np.floor(since)
        meet = np.minimum(since, 1 - since) * apart < near
        known = np.where(meet, np.minimum(known, up - near), known)
        up = up + beside
    return np.minimum(np.minimum(known, up), MOST)


def opened(
    crowd: Crowd,
    ahead: Ahead,
    machine: StateMachine,
    world: LabelMap,
    tables: Tables,
    way: Callable[[Crowd], Crowd],
) -> Ahead | None:
    """Return `ahead` with new `turns`, where none were left.

    Returns None if too many agents make long steps.

    way: makes a step of the `tables` for agents of which nothing is known.
    """
    for count, part in *((count, FEW) for count in TOGETHER), (1, MANY):
        ends = ahead.steps < count
        if np.count_nonzero(ends) <= part * len(crowd):
            break
    else:
        return None
    agents, until, made, most, rounds = (
        np.flatnonzero(ends),
        ahead.steps.copy(),
        [],
        2 * part * len(crowd),
        0,
    )
    some, case, when = crowd.of(agents), ahead.case[agents], ahead.steps[agents].astype(int)
    at = np.zeros(len(agents), int)
    while len(agents) and rounds < ROUNDS and most >= 0:
        some = _on(some, case, when - at, tables) if (when > at).any() else some
        moved, rest = within(some, machine, world, tables, NOTHING)
        moved = mended(moved, some, rest, way)
        turns = moved.heading.view(np.int32) != some.heading.view(np.int32)
        turns[rest] = True
        # the map's border may have stopped them, or a zero lost its sign
        for name, by in (("x", tables.x), ("y", tables.y)):
            old, new = getattr(some, name), getattr(moved, name)
            straight = old + by.take(case) if name in tables.changing else old
            turns |= straight.view(np.int64) != new.view(np.int64)
        (turns,) = turns.nonzero()  # the others do what they did, into a cell of the same label
        there = look(moved, machine, world, tables)
        made.append(
            (when[turns], agents[turns], some.of(turns), moved.of(turns), there.case[turns])
        )
        most, rounds = most - len(agents), rounds + 1
        at, when = when + 1, when + 1 + there.steps
        until[agents] = when
        again = np.flatnonzero(when < count)
        agents, some, case, at, when = (
            agents[again],
            moved.of(again),
            there.case[again],
            at[again],
            when[again],
        )
    # up to the first end of what is known; those made that come later are forgotten
    if len(agents):
        count = int(when.min())
        for late, who, *_ in reversed(made):
            until[who[late >= count]] = late[late >= count]
    return replace(
        ahead,
        steps=until - np.uint16(count),
        turns=_turns(made, count, tables.changing) if made else (NOBODY,) * count,
    )


def onward(
    crowd: Crowd, ahead: Ahead, tables: Tables, way: Callable[[Crowd], Crowd]
) -> tuple[Crowd, Ahead | None]:
    """Return (crowd, Ahead) one step of the `tables` later.

    The step is as long as those of `ahead`, or shorter; after a shorter one the Ahead is None.

    way: makes this step for agents of which nothing is known.
    """
    turn, *turns = ahead.turns
    columns = {name: np.empty_like(getattr(crowd, name)) for name in tables.changing}
    _go_on(crowd, ahead.case, tables, columns)
    if tables.seconds != ahead.seconds:
        return mended(replace(crowd, **columns), crowd, turn.agents, way), None
    case = ahead.case
    if len(turn.agents):
        case = case.copy()
        case[turn.agents] = turn.case
    for name, values in turn.after.items():
        if name not in columns:
            columns[name] = getattr(crowd, name).copy()
        columns[name][turn.agents] = values
    return replace(crowd, **columns), replace(ahead, case=case, turns=tuple(turns))


def _turns(made: list[tuple], count: int, changing: list[str]) -> tuple[Turn, ...]:
    """Return the turns of `count` steps, one Turn a step.

    made: tuples (step (k,), agents (k,), Crowd before, Crowd after, case from then on (k,)).
    changing: columns that steps known ahead change.
    """
    when, agents, case = (np.concatenate([each[k] for each in made]) for k in (0, 1, 4))
    order = np.argsort(when, kind="stable")
    ends = np.searchsorted(when[order], np.arange(count + 1)).tolist()
    parts = [slice(*ends[k : k + 2]) for k in range(count)]
    agents, case = agents[order], case[order]
    after: list[dict[str, np.ndarray]] = [{} for _ in parts]
    for name in made[0][2].columns:
        old, new = (np.concatenate([getattr(each[k], name) for each in made]) for k in (2, 3))
        if name in changing or old.tobytes() != new.tobytes():
            old, new = old[order], new[order]
            for turn, part in zip(after, parts, strict=True):
                if name in changing or old[part].tobytes() != new[part].tobytes():
                    turn[name] = new[part]
    return tuple(
        Turn(agents[part], turn, case[part]) for turn, part in zip(after, parts, strict=True)
    )


def _on(crowd: Crowd, case: np.ndarray, steps: np.ndarray, tables: Tables) -> Crowd:
    """Return the crowd after `steps` (n,), each agent's own number of known steps."""
    order = np.argsort(-steps, kind="stable")
    crowd, case, steps = crowd.of(order), case[order], steps[order]
    for count in np.searchsorted(-steps, -np.arange(steps.max()), side="left").tolist():
        some = crowd.of(slice(count))
        _go_on(some, case[:count], tables, vars(some))
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return crowd.of(back)


def _go_on(crowd: Crowd, cases: np.ndarray, tables: Tables, into: dict[str, np.ndarray]) -> None:
    """Write the columns that a step of the `tables` changes to `into`.

    The values are right only for agents whose step is known.
    """
    for at in range(0, len(crowd), BLOCK):
        block = slice(at, at + BLOCK)
        case = cases[block].astype(np.intp)
        for name, way in (("x", tables.x), ("y", tables.y)):
            if name in tables.changing:
                np.add(
                    getattr(crowd, name)[block], way.take(case, mode="clip"), out=into[name][block]
                )
        if "wait" in tables.changing:
            np.subtract(crowd.wait[block], tables.seconds, out=into["wait"][block])
