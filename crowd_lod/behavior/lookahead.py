"""Steps without a look at the map, for agents known to walk straight on.

Until an agent reaches another label, a corner of cells, or the end of its timer, each step adds the
same displacement to its position. The number of such steps is computed once. While it lasts, a few
additions step all agents at once, with the results of plain_step.advance.

When an agent's known steps end, it is looked at again. An agent that only enters the next cell of
its label goes on; every other one takes a plain step. Agents do not look at each other, so the
plain steps of several coming frames, each agent's at its own time, are computed together and kept
until their frames: the calls of such a step cost more than its agents.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap
from .tabulated_step import BLOCK, Tables, merge_columns, step_within_cells

# The most steps that are known ahead.
MOST = 4095
# Counts of steps whose turns are computed together: the first count in which no more than the part
# FEW of the crowd turns, or no more than CHEAP agents, who cost less than the calls.
TOGETHER = (16, 4)
FEW = 1 / 16
CHEAP = 1000
# Where more than this part of a crowd turns in a step, it is stepped faster as a whole.
MANY = 0.25
# Borders along x that agents who walk aslant are followed across, at most.
CROSSED = 4
# Turns of an agent that are computed together, at most.
ROUNDS = 6
# A border counts as nearer than it is by this many spacings of the map's largest coordinate: more
# than MOST steps can err by rounding.
SLACK = 8192
# A timer counts as shorter than it is by this part: more than MOST roundings to float64.
TICK = 1e-12
# Agents that walk less than this part of a cell in a step are followed through cells of one label.
SLOW = 0.99


@dataclass(frozen=True)
class Turn:
    """The agents that take a plain step in one frame, and what it makes of them.

    agents: (m,) intp.
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
    turns: those of the next frames, one Turn a frame.
    """

    case: np.ndarray
    steps: np.ndarray
    seconds: float
    turns: tuple[Turn, ...] = ()


class _Round(NamedTuple):
    """Plain steps of k agents, each at its own time.

    step: (k,) intp, in how many steps from now.
    agents: (k,) intp.
    before, after: the k agents before and after it.
    case: (k,), the case of Tables that each agent follows from then on.
    """

    step: np.ndarray
    agents: np.ndarray
    before: Crowd
    after: Crowd
    case: np.ndarray


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def look_ahead(crowd: Crowd, machine: StateMachine, world: LabelMap, tables: Tables) -> Ahead:
    """Return what is known of the crowd's next steps, as long as that of `tables`."""
    cases = np.empty(len(crowd), tables.number)
    steps = np.empty(len(crowd), np.uint16)
    heading = tables.heading.view(np.int32)  # 0.0 and -0.0 are two
    for start in range(0, len(crowd), BLOCK):
        block = slice(start, start + BLOCK)
        case, safe_steps = _look_at_block(crowd, block, world, tables)
        if machine.timed:
            until_timer = crowd.wait[block] / tables.seconds * (1 - TICK) - 2
            safe_steps = np.minimum(safe_steps, until_timer)
        turned = heading.take(case) != crowd.heading[block].view(np.int32)
        safe_steps[tables.turns.take(case) & turned] = 0
        cases[block] = case
        steps[block] = np.where(safe_steps >= 1, safe_steps, 0)
    return Ahead(cases, steps, tables.seconds)


def _look_at_block(
    crowd: Crowd, block: slice, world: LabelMap, tables: Tables
) -> tuple[np.ndarray, np.ndarray]:
    """Return (case, safe_steps) of a block of agents.

    case: (b,) intp, of Tables.
    safe_steps: (b,) float64, for how many steps they stay in their label.
    """
    area = world.area
    rows, columns = world.labels.shape
    width, depth = world.cell
    x = crowd.x[block]
    y = crowd.y[block]
    column = np.floor((x - area.x_min) / width)
    row = np.floor((y - area.y_min) / depth)
    cell = (row * columns + column).astype(np.intp)
    case = tables.cases(crowd, block, world.labels.ravel().take(cell, mode="clip"))
    # by less than a cell a step, agents go on through cells of the same label, in one row or in one
    # column of them
    is_slow_x = np.abs(tables.x) < SLOW * width
    is_slow_y = np.abs(tables.y) < SLOW * depth
    along_y = tables.x == 0
    slack = _slack(world)
    safe_steps = np.full(len(case), float(MOST))
    rooms = []
    for place, steps_of_cases, low, size, index, runs, goes_through in (
        (x, tables.x, area.x_min, width, column, world.runs[0], is_slow_x),
        (y, tables.y, area.y_min, depth, row, world.runs[1], is_slow_y & along_y),
    ):
        step = steps_of_cases.take(case)
        forward = step > 0
        room = np.abs(low + (index + forward) * size - place) - slack
        cells_ahead = runs.take(forward * runs.shape[1] + cell, mode="clip")
        way = room + size * goes_through.take(case) * cells_ahead
        np.minimum(safe_steps, way / np.abs(step), where=step != 0, out=safe_steps)
        rooms.append(room)
    is_aslant = is_slow_x & is_slow_y & ~along_y & (tables.y != 0)
    (aslant,) = is_aslant.take(case).nonzero()
    if len(aslant):
        ways = np.array([tables.x, tables.y])[:, case[aslant]]
        steps = _look_aslant(np.array(rooms)[:, aslant], ways, cell[aslant], world)
        safe_steps[aslant] = np.maximum(safe_steps[aslant], steps)
    safe_steps[_is_odd(x, column, columns) | _is_odd(y, row, rows)] = 0
    return case, safe_steps


def _slack(world: LabelMap) -> float:
    """Return the meters by which a border counts as nearer than it is."""
    return SLACK * np.spacing(np.abs(world.area.bounds).max())


def _is_odd(place: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """Return (b,) bool: who is off the map, at NaN, or at -0.0, which a step turns to 0.0."""
    return ~((index >= 0) & (index < count)) | ((place == 0) & np.signbit(place))


def _look_aslant(
    rooms: np.ndarray, ways: np.ndarray, cell: np.ndarray, world: LabelMap
) -> np.ndarray:
    """Return for how many steps agents that walk aslant stay in their label, (m,).

    In these steps no agent goes through a corner of cells. Both borders are crossed in one step
    only where an agent reaches them less than a step apart.

    rooms: (2, m) meters to the borders ahead, along x and y.
    ways: (2, m) meters of a step.
    cell: (m,) indices into the flat map.
    """
    size = np.array(world.cell)[:, None]
    pace = np.abs(ways)
    quadrant = 2 * (ways[1] > 0) + (ways[0] > 0)
    side = world.squares.reshape(-1).take(quadrant * world.labels.size + cell, mode="clip")
    safe_steps = ((rooms + (side - 1.0) * size) / pace).min(axis=0)
    # steps to the next border along x and y, and between two of them
    across, up = rooms / pace
    apart, beside = size / pace
    near = 1.01 + 2 * _slack(world) * (1 / pace).sum(axis=0)
    for _ in range(CROSSED):
        since = (up - across) / apart
        since -= np.floor(since)
        meet = np.minimum(since, 1 - since) * apart < near
        safe_steps = np.where(meet, np.minimum(safe_steps, up - near), safe_steps)
        up = up + beside
    return np.minimum(np.minimum(safe_steps, up), MOST)


def plan_turns(
    crowd: Crowd,
    ahead: Ahead,
    machine: StateMachine,
    world: LabelMap,
    tables: Tables,
    way: Callable[[Crowd], Crowd],
) -> Ahead | None:
    """Return `ahead` with new `turns`, where none were left.

    Returns None if too many agents turn.

    way: makes a step of the `tables` for agents of which nothing is known.
    """
    choice = _choose_count(ahead.steps)
    if choice is None:
        return None
    count, most = choice
    until = ahead.steps.copy()
    agents = np.flatnonzero(until < count)
    before = crowd.of(agents)
    case = ahead.case[agents]
    now = np.zeros(len(agents), int)
    end = until[agents].astype(int)
    rounds: list[_Round] = []
    budget = 2 * most
    while len(agents) and len(rounds) < ROUNDS and budget >= 0:
        before = _walk_known(before, case, end - now, tables)
        moved, plain_agents = step_within_cells(before, machine, world, tables)
        after = merge_columns(moved, before, plain_agents, way)
        turning = _find_turns(before, after, case, plain_agents, tables)
        onward = look_ahead(after, machine, world, tables)
        turn = agents[turning], before.of(turning), after.of(turning), onward.case[turning]
        rounds.append(_Round(end[turning], *turn))
        budget -= len(agents)
        now = end + 1
        end = now + onward.steps
        until[agents] = end
        again = np.flatnonzero(end < count)
        before = after.of(again)
        agents = agents[again]
        case = onward.case[again]
        now = now[again]
        end = end[again]
    if len(agents):  # up to the first end of what is known; later turns are forgotten
        count = int(end.min())
        for turned in reversed(rounds):
            late = turned.step >= count
            until[turned.agents[late]] = turned.step[late]
    turns = _turns(rounds, count, tables.changing) if rounds else (NOBODY,) * count
    return replace(ahead, steps=until - np.uint16(count), turns=turns)


def _choose_count(steps: np.ndarray) -> tuple[int, float] | None:
    """Return (count, most): for how many steps turns are computed together, and of how many agents.

    None if more than MANY turn in the next step.
    """
    many = MANY * len(steps)
    if np.count_nonzero(steps < 1) > many:
        return None
    most = max(FEW * len(steps), CHEAP)
    for count in TOGETHER:
        if np.count_nonzero(steps < count) <= most:
            return count, most
    return 1, many


def _find_turns(
    before: Crowd, after: Crowd, case: np.ndarray, plain_agents: np.ndarray, tables: Tables
) -> np.ndarray:
    """Return (m,) intp, who did not do what its case says; the rest entered a cell of its label.

    case: (n,), of Tables.
    plain_agents: indices of those who took a plain step.
    """
    turns = after.heading.view(np.int32) != before.heading.view(np.int32)
    turns[plain_agents] = True
    # the map's border may have stopped them, or a zero lost its sign
    for name, by in (("x", tables.x), ("y", tables.y)):
        old = getattr(before, name)
        new = getattr(after, name)
        straight = old + by.take(case) if name in tables.changing else old
        turns |= straight.view(np.int64) != new.view(np.int64)
    return np.flatnonzero(turns)


def step_ahead(
    crowd: Crowd, ahead: Ahead, tables: Tables, way: Callable[[Crowd], Crowd]
) -> tuple[Crowd, Ahead | None]:
    """Return (crowd, Ahead) one step of the `tables` later.

    The step is as long as those of `ahead`, or shorter; after a shorter one the Ahead is None.

    way: makes this step for agents of which nothing is known.
    """
    turn, *turns = ahead.turns
    columns = {name: np.empty_like(getattr(crowd, name)) for name in tables.changing}
    _add_step(crowd, ahead.case, tables, columns)
    if tables.seconds != ahead.seconds:
        return merge_columns(replace(crowd, **columns), crowd, turn.agents, way), None
    case = ahead.case
    if len(turn.agents):
        case = case.copy()
        case[turn.agents] = turn.case
    for name, values in turn.after.items():
        if name not in columns:
            columns[name] = getattr(crowd, name).copy()
        columns[name][turn.agents] = values
    return replace(crowd, **columns), replace(ahead, case=case, turns=tuple(turns))


def _turns(rounds: list[_Round], count: int, changing: list[str]) -> tuple[Turn, ...]:
    """Return the turns of `count` steps, one Turn a step.

    changing: columns that steps known ahead change.
    """
    step = np.concatenate([turned.step for turned in rounds])
    order = np.argsort(step, kind="stable")
    ends = np.searchsorted(step[order], np.arange(count + 1)).tolist()
    parts = [slice(*ends[k : k + 2]) for k in range(count)]
    agents = np.concatenate([turned.agents for turned in rounds])[order]
    case = np.concatenate([turned.case for turned in rounds])[order]
    columns: list[dict[str, np.ndarray]] = [{} for _ in parts]
    for name in rounds[0].before.columns:
        old = np.concatenate([getattr(turned.before, name) for turned in rounds])[order]
        new = np.concatenate([getattr(turned.after, name) for turned in rounds])[order]
        for after, part in zip(columns, parts, strict=True):
            if name in changing or old[part].tobytes() != new[part].tobytes():
                after[name] = new[part]
    return tuple(
        Turn(agents[part], after, case[part]) for after, part in zip(columns, parts, strict=True)
    )


def _walk_known(crowd: Crowd, case: np.ndarray, steps: np.ndarray, tables: Tables) -> Crowd:
    """Return the crowd after `steps` (n,), each agent's own number of known steps."""
    if not steps.any():
        return crowd
    order = np.argsort(-steps, kind="stable")
    crowd = crowd.of(order)
    case = case[order]
    counts = np.searchsorted(-steps[order], -np.arange(steps.max()), side="left")
    for count in counts.tolist():
        walking = crowd.of(slice(count))
        _add_step(walking, case[:count], tables, vars(walking))
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return crowd.of(back)


def _add_step(crowd: Crowd, cases: np.ndarray, tables: Tables, into: dict[str, np.ndarray]) -> None:
    """Write the columns that a step of the `tables` changes to `into`.

    The values are right only for agents whose step is known.
    """
    for start in range(0, len(crowd), BLOCK):
        block = slice(start, start + BLOCK)
        case = cases[block].astype(np.intp)
        for name, way in (("x", tables.x), ("y", tables.y)):
            if name in tables.changing:
                old = getattr(crowd, name)[block]
                np.add(old, way.take(case, mode="clip"), out=into[name][block])
        if "wait" in tables.changing:
            np.subtract(crowd.wait[block], tables.seconds, out=into["wait"][block])
