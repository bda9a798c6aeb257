"""Stiff cases of behavior, each with a name: steps against the slow judge of exact_behavior."""

import json
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..behavior.plain_step import advance
from ..behavior.step import check_speeds
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine, parse
from ..errors import CrowdError
from ..format import aligned
from ..mesh import connected_components
from ..world.maps import Area, LabelMap
from .exact_behavior import follow_exactly
from .exact_frustum import standing_crowd

FRAME = 1 / 24  # seconds
# Agents of a case, and of one whose steps are long for the judge.
AGENTS = 40
FEW = 10
SIZE = 64  # cells along a side of the rooms
ASLANT = 1.0, 0.75  # m/s along x and y
# Parts of a cell by which rounding may put an agent into a wall, or over its edge.
ROUNDING = 1e-6


@dataclass(frozen=True)
class StiffCase:
    """A crowd that is hard to step.

    seconds: of each of its `steps`.
    """

    name: str
    crowd: Crowd
    machine: StateMachine
    world: LabelMap
    seconds: float = FRAME
    steps: int = 24


@dataclass(frozen=True)
class StiffRow:
    """What became of a case.

    stand: agents that turned too often in a step, and stood until it ended.
    chatter: of all agents, those that truly can go nowhere: time cannot go on for them.
    unknown: agents on which the judge gave up.
    broken: agents off the map, at NaN, in a wall or behind it; always 0.
    median, worst: meters from where the judge sees the agents that it knows.
    cells: the worst in cells of the map.
    milliseconds: of the longest step.
    note: the error if the step was refused.
    """

    name: str
    agents: int
    steps: int
    stand: int = 0
    chatter: int = 0
    unknown: int = 0
    broken: int = 0
    median: float = 0.0
    worst: float = 0.0
    cells: float = 0.0
    milliseconds: float = 0.0
    note: str = ""


def turning_machine(
    way: tuple[float, float],
    back: tuple[float, float] | None = None,
    edge: str = "clamp",
    chance: bool = False,
) -> StateMachine:
    """Return a table by which agents go `way`, m/s, and turn back at walls.

    back: m/s, where they go then; straight back if None.
    chance: whether they turn by chance, one time in two.
    """
    x, y = way
    back_x, back_y = back or (-x, -y)
    turn_back = {"out": 1, "back": 1} if chance else "back"
    turn_out = {"out": 1, "back": 1} if chance else "out"
    return _machine(
        {
            "out": {
                "start": 1,
                "on": {
                    "ground": {"move": [x, y]},
                    "wall": {"next": turn_back, "move": [back_x, back_y]},
                },
            },
            "back": {
                "on": {
                    "ground": {"move": [back_x, back_y]},
                    "wall": {"next": turn_out, "move": [x, y]},
                }
            },
        },
        edge,
    )


def _machine(states: dict, edge: str = "clamp", other: str = "wall") -> StateMachine:
    """Return a table of the labels "ground" and `other`."""
    labels = {"ground": {"color": "#808080"}, other: {"color": "#202020"}}
    return parse(
        json.dumps({"version": 1, "edge": edge, "labels": labels, "states": states}), "stiff case"
    )


def room(cell: float = 1.0, offset: float = 0.0) -> LabelMap:
    """Return SIZE by SIZE cells with walls all around."""
    labels = np.pad(np.zeros((SIZE - 2, SIZE - 2), np.uint8), 1, constant_values=1)
    return LabelMap(labels, Area(offset, offset, offset + SIZE * cell, offset + SIZE * cell))


def diagonal_walls() -> LabelMap:
    """Return a map of cells of 1 m, ground and wall by turns, so that walls touch at corners."""
    labels = 1 - np.indices((6, 6)).sum(axis=0) % 2
    return LabelMap(labels.astype(np.uint8), Area(0, 0, 6, 6))


def crowd_in(world: LabelMap, random: np.random.Generator, count: int = AGENTS) -> Crowd:
    """Return `count` agents in state 0 at random places on the ground."""
    cells = np.argwhere(world.labels == 0)
    row, column = cells[random.integers(len(cells), size=count)].T
    width, depth = world.cell
    x = world.area.x_min + (column + random.uniform(0.1, 0.9, count)) * width
    y = world.area.y_min + (row + random.uniform(0.1, 0.9, count)) * depth
    return standing_crowd(np.stack([x, y, np.zeros(count)], axis=1))


def _crowd_near_corners(random: np.random.Generator) -> Crowd:
    """Return agents 1e-1 to 1e-12 m before the corner at (3, 3) of diagonal_walls."""
    away = 10.0 ** random.uniform(-12, -1, AGENTS)
    x = 3 - away
    y = 3 + away * random.uniform(0.1, 0.9, AGENTS)
    return standing_crowd(np.stack([x, y, np.zeros(AGENTS)], axis=1))


def stiff_cases(seed: int = 0) -> list[StiffCase]:
    """Return the cases; `seed` draws their agents."""
    random = np.random.default_rng(seed)
    # The random numbers are drawn in this order.
    near_corners = _crowd_near_corners(random)
    hall = room()
    plain = LabelMap(np.zeros((64, 64), np.uint8), hall.area)
    ticking = replace(crowd_in(plain, random, FEW), wait=np.full(FEW, 0.001))
    lost = crowd_in(hall, random)
    lost.x[:3] = np.nan
    ticks = _ticking_machine()
    return [
        *_chattering_cases(random),
        *_corner_cases(near_corners),
        *_fast_cases(random, hall, plain),
        *_rounding_cases(random, hall),
        StiffCase("timers of 0.001 s", ticking, ticks, plain, steps=4),
        StiffCase("timers of 0.001 s, steps of 0.5 s", ticking, ticks, plain, 0.5, 2),
        StiffCase("three agents at NaN", lost, turning_machine(ASLANT), hall),
    ]


def _ticking_machine() -> StateMachine:
    """Return a table whose two states change by a timer of 0.001 s."""
    return _machine(
        {
            "a": {"start": 1, "after": 0.001, "then": "b", "on": {"*": {"move": [1, 0.5]}}},
            "b": {"after": 0.001, "then": "a", "on": {"*": {"move": [1, -0.5]}}},
        }
    )


def _chattering_cases(random: np.random.Generator) -> list[StiffCase]:
    """Return cases in which a state or a direction changes again and again in one place."""
    pair = LabelMap(np.tile(np.array([[0, 1]], np.uint8), (4, 1)), Area(0, 0, 2, 4))
    stripes = LabelMap(np.tile(np.array([[0, 1]], np.uint8), (8, 32)), Area(0, 0, 64, 8))
    to_and_fro = {"to": {"on": {"ground": {"move": [1, 0]}, "wall": {"move": [-1, 0]}}}}
    by_turns = {
        "a": {
            "start": 1,
            "on": {
                "ground": {"next": "b", "move": [24, 1]},
                "stripe": {"next": "b", "move": [24, -1]},
            },
        },
        "b": {"on": {"*": {"next": "a", "move": [24, 0]}}},
    }
    return [
        StiffCase(
            "chatter: to and fro over a border", crowd_in(pair, random), _machine(to_and_fro), pair
        ),
        StiffCase(
            "chatter: another state at each step",
            crowd_in(stripes, random),
            _machine(by_turns, "wrap", "stripe"),
            stripes,
        ),
    ]


def _corner_cases(crowd: Crowd) -> list[StiffCase]:
    """Return cases of a crowd before a corner at which two walls touch."""
    few = crowd.of(slice(FEW))
    walls = diagonal_walls()
    fast = turning_machine((2400.0, 1800.0))
    another_way = turning_machine(ASLANT, (-1.0, -0.7578125))
    by_chance = turning_machine(ASLANT, chance=True)
    return [
        StiffCase("walls touch at a corner", crowd, turning_machine(ASLANT), walls, steps=8),
        StiffCase("the same, 100 cells a step", crowd, fast, walls, steps=4),
        StiffCase("the same, back another way", few, another_way, walls, steps=4),
        StiffCase("the same, turns by chance", few, by_chance, walls, steps=4),
    ]


def _fast_cases(random: np.random.Generator, hall: LabelMap, plain: LabelMap) -> list[StiffCase]:
    """Return cases that cross many cells in a step."""
    return [
        StiffCase(
            "60,000 cells a step",
            crowd_in(hall, random, FEW),
            turning_machine((60_000 / FRAME, 0.0)),
            hall,
            steps=2,
        ),
        StiffCase(
            "1,000,000 cells a step",
            crowd_in(hall, random, FEW),
            turning_machine((1e6 / FRAME, 0.0)),
            hall,
        ),
        StiffCase(
            "60 cells a step, reflected",
            crowd_in(plain, random, FEW),
            turning_machine((1440.0, 961.0), edge="reflect"),
            plain,
            steps=4,
        ),
    ]


def _rounding_cases(random: np.random.Generator, hall: LabelMap) -> list[StiffCase]:
    """Return cases of very long and short lengths and times, where rounding counts."""
    machine = turning_machine(ASLANT)
    far = room(offset=1e8)
    tiny = room(cell=1e-6)

    def case(name: str, world: LabelMap, seconds: float, steps: int, count: int = FEW) -> StiffCase:
        return StiffCase(name, crowd_in(world, random, count), machine, world, seconds, steps)

    return [
        case("1e8 m from the origin", far, FRAME, 24, AGENTS),
        case("1e8 m from the origin, steps of 1e-9 s", far, 1e-9, 100),
        case("steps of 1e-9 s", hall, 1e-9, 100),
        case("a step of an hour", hall, 3600.0, 1),
        case("cells of 1e-6 m", tiny, FRAME / 8, 4),
    ]


def judge_behavior(seed: int = 0) -> Iterator[StiffRow]:
    """Yield a row for each of the stiff cases."""
    for case in stiff_cases(seed):
        try:
            check_speeds(case.machine, case.world, case.seconds)
        except CrowdError as error:
            yield StiffRow(case.name, len(case.crowd), case.steps, note=str(error))
        else:
            yield _judge_case(case)


def _judge_case(case: StiffCase) -> StiffRow:
    crowd = case.crowd
    stand = np.zeros(len(crowd), bool)
    longest = 0.0
    for _ in range(case.steps):
        started = clock.perf_counter()
        crowd, tally = advance(crowd, case.machine, case.world, case.seconds)
        longest = max(longest, clock.perf_counter() - started)
        stand |= tally.stuck
    placed = np.flatnonzero(np.isfinite(case.crowd.x))
    truth = follow_exactly(
        case.crowd.of(placed), case.machine, case.world, case.seconds, case.steps
    )
    away = np.abs(np.stack([crowd.x[placed] - truth.x, crowd.y[placed] - truth.y]))[
        :, ~truth.unknown
    ]
    if case.machine.edge == "wrap":
        away = np.minimum(away, np.array(case.world.area.size)[:, None] - away)
    meters = np.hypot(*away)
    return StiffRow(
        name=case.name,
        agents=len(crowd),
        steps=case.steps,
        stand=int(stand.sum()),
        chatter=int(truth.chatters.sum()),
        unknown=int(truth.unknown.sum()),
        broken=int(_is_broken(case, crowd.of(placed), case.crowd.of(placed)).sum()),
        median=float(np.median(meters)) if len(meters) else 0.0,
        worst=float(meters.max(initial=0)),
        cells=float((away / np.array(case.world.cell)[:, None]).max(initial=0)),
        milliseconds=1000 * longest,
    )


def _is_broken(case: StiffCase, crowd: Crowd, start: Crowd) -> np.ndarray:
    """Return (n,) bool: agents that are nowhere, off the map, in a wall, or walled off from their
    start.

    An agent may stand on the border of a wall, which counts as the ground beside it.
    """
    world = case.world
    within = np.zeros(len(crowd), bool)
    regions = _regions(world, case.machine)
    home = regions[world.cells(start.x, start.y)[::-1]]
    width, depth = world.cell
    # the cells that an agent touches
    for aside in (-ROUNDING, ROUNDING):
        for along in (-ROUNDING, ROUNDING):
            column, row = world.cells(crowd.x + aside * width, crowd.y + along * depth)
            within |= regions[row, column] == home
    area = world.area
    on_map = (
        (crowd.x >= area.x_min)
        & (crowd.x <= area.x_max)
        & (crowd.y >= area.y_min)
        & (crowd.y <= area.y_max)
    )
    return ~(within & on_map)


def _regions(world: LabelMap, machine: StateMachine) -> np.ndarray:
    """Return (rows, columns) intp, the region of each cell.

    A region's cells are joined by their sides. A cell of the label "wall" is a region by itself.
    """
    numbers = np.arange(world.labels.size).reshape(world.labels.shape)
    walkable = np.array([label != "wall" for label in machine.labels])[world.labels]
    beside = walkable[:, 1:] & walkable[:, :-1]
    above = walkable[1:] & walkable[:-1]
    pairs_beside = np.stack([numbers[:, 1:][beside], numbers[:, :-1][beside]], axis=1)
    pairs_above = np.stack([numbers[1:][above], numbers[:-1][above]], axis=1)
    joined = np.concatenate([pairs_beside, pairs_above])
    return connected_components(world.labels.size, joined).reshape(world.labels.shape)


def behavior_text(rows: list[StiffRow]) -> str:
    """Return the table as lines of text."""
    head = (
        "case",
        "agents",
        "steps",
        "stand",
        "chatter",
        "unknown",
        "broken",
        "median m",
        "worst m",
        "in cells",
        "ms",
    )
    lines = []
    for row in rows:
        counts = (row.agents, row.steps, row.stand, row.chatter, row.unknown, row.broken)
        errors = (row.median, row.worst, row.cells)
        lines.append(
            (
                row.name,
                *(f"{n:,}" for n in counts),
                *(f"{e:.1e}" for e in errors),
                f"{row.milliseconds:.1f}",
            )
        )
    notes = [f"{row.name}: {row.note}" for row in rows if row.note]
    return "\n".join([*aligned(head, lines), *notes])
