"""Extreme cases of steps, each with a name: a walk, as frames run it, beside the exact judge."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..behavior.step import MOST_CELLS, courant
from ..behavior.walk import Walk
from ..crowd.agents import Crowd, Group
from ..crowd.state_machine import StateMachine, parse
from ..errors import CrowdError
from ..mesh import connected_components
from ..world.maps import Area, LabelMap
from .behavior_errors import offsets
from .exact_behavior import follow_exactly
from .exact_frustum import standing_crowd

FRAME = 1 / 24  # seconds
# Agents of a case, and of one whose steps are long for the judge.
AGENTS = 40
FEW = 10
SIZE = 64  # cells along a side of the rooms
ASLANT = 1.0, 0.75  # m/s along x and y
# Parts of a cell: by which rounding may put an agent into a wall or over its edge, by which a walk
# may be off, and by which it may where agents stand until a step ends, for it has too many pieces.
ROUNDING = 1e-6
EXACT = 1e-4
STANDS = 0.15
PERSON = Group("person", 0.9, 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class StiffCase:
    """A crowd that is hard to step.

    seconds: of each of its `steps`.
    bound: cells of the map by which the worst agent may be off.
    first: the frame at which it begins.
    """

    name: str
    crowd: Crowd
    machine: StateMachine
    world: LabelMap
    seconds: float = FRAME
    steps: int = 24
    bound: float = EXACT
    first: int = 1


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


def cases(seed: int = 0) -> list[StiffCase]:
    """Return the cases; `seed` draws their agents."""
    random = np.random.default_rng(seed)
    # The random numbers are drawn in this order.
    near_corners = _crowd_near_corners(random)
    hall = room()
    plain = LabelMap(np.zeros((64, 64), np.uint8), hall.area)
    ticking = replace(crowd_in(plain, random, FEW), wait=np.full(FEW, 0.001))
    ticks = _ticking_machine()
    return [
        *_chattering_cases(random),
        *_corner_cases(near_corners),
        *_fast_cases(random, hall, plain),
        *_rounding_cases(random, hall),
        StiffCase("timers of 0.001 s", ticking, ticks, plain, steps=4),
        StiffCase("timers of 0.001 s, steps of 0.5 s", ticking, ticks, plain, 0.5, 2, 2.0),
        *_new_cases(random, hall),
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
        StiffCase(
            "walls touch at a corner", crowd, turning_machine(ASLANT), walls, steps=8, bound=STANDS
        ),
        StiffCase("the same, 100 cells a step", crowd, fast, walls, steps=4, bound=STANDS),
        StiffCase("the same, back another way", few, another_way, walls, steps=4, bound=STANDS),
        StiffCase("the same, turns by chance", few, by_chance, walls, steps=4, bound=STANDS),
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


def _new_cases(random: np.random.Generator, hall: LabelMap) -> list[StiffCase]:
    """Return cases of maps of one row, of speeds at both ends, and of first frames far back."""
    row = LabelMap(np.zeros((1, 64), np.uint8), Area(0, 0, 64, 1))
    round_row = {"go": {"on": {"*": {"move": [3.0, 0.4]}}}}
    creep = {"go": {"on": {"*": {"move": [1e-300, -1e-300]}}}}
    across = {"go": {"on": {"*": {"move": [SIZE / FRAME, 0.0]}}}}
    machine = turning_machine(ASLANT)
    columns = [
        StiffCase(f"three agents at {value} in {axis}", _with(crowd_in(hall, random), axis, value),
                  machine, hall)
        for axis in "xy"
        for value in (np.nan, np.inf)
    ]  # fmt: skip
    return [
        StiffCase(
            "a map of one row, wrapped", crowd_in(row, random), _machine(round_row, "wrap"), row
        ),
        StiffCase("speeds of 1e-300 m/s", crowd_in(hall, random), _machine(creep), hall),
        StiffCase("a map a step", crowd_in(row, random), _machine(across, "wrap"), row),
        StiffCase("first frame -1e6", crowd_in(hall, random), machine, hall, first=-1_000_000),
        *(
            StiffCase(f"unit scale {size:g}", crowd_in(each, random), _scaled(size), each)
            for size in (1e-3, 1e3)
            for each in [room(cell=size)]
        ),
        *columns,
    ]


def _with(crowd: Crowd, axis: str, value: float) -> Crowd:
    """Return the crowd with three agents at this value along an axis."""
    getattr(crowd, axis)[:3] = value
    return crowd


def _scaled(size: float) -> StateMachine:
    """Return a table of speeds that are `size` times as large."""
    return turning_machine((ASLANT[0] * size, ASLANT[1] * size))


def judge(case: StiffCase) -> Iterator[tuple[str, float, float]]:
    """Yield (quantity, error, bound) of what is wrong after the case's steps."""
    placed = np.flatnonzero(np.isfinite(case.crowd.x) & np.isfinite(case.crowd.y))
    walk = Walk(case.crowd, case.machine, case.world, (PERSON,), case.seconds, case.first)
    try:
        for step in range(1, case.steps + 1):
            crowd = walk.at(case.first + step)
    except CrowdError:
        is_fast = courant(case.machine, case.world, case.seconds).max() > MOST_CELLS
        yield "steps refused, other than for their speed", float(not is_fast), 0
        return
    start = case.crowd.of(placed)
    truth = follow_exactly(start, case.machine, case.world, case.seconds, case.steps)
    crowd = crowd.of(placed)
    away = offsets(crowd, truth, walk)[:, ~truth.unknown]
    cells = away / np.array(case.world.cell)[:, None]
    yield "agents broken", float(_is_broken(case, crowd, start).sum()), 0
    yield "off by cells", float(cells.max(initial=0)), case.bound


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
