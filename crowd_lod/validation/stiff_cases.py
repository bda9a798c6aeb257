"""Extreme cases of steps, a table of crowds: a walk as frames run it, beside the exact judge."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

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
class BoundedError:
    """A line of the table: how large an error is in a case, and how large it may be.

    quantity: what is wrong, with its unit.
    """

    case: str
    quantity: str
    error: float
    bound: float

    @property
    def ok(self) -> bool:
        """Whether the error is within its bound; NaN is not."""
        return self.error <= self.bound


@dataclass(frozen=True)
class StiffCase:
    """A crowd that is hard to step, at random places on the ground.

    seconds: of each of its `steps`.
    bound: cells of the map by which the worst agent may be off.
    first: the frame at which it begins.
    wait: seconds of the agents' timers.
    corner: where agents stand 1e-1 to 1e-12 m to the upper left of it instead, meters.
    lost: (axis, value): where three agents are.
    """

    name: str
    world: LabelMap
    machine: StateMachine
    count: int = AGENTS
    seconds: float = FRAME
    steps: int = 24
    bound: float = EXACT
    first: int = 1
    wait: float = np.inf
    corner: tuple[float, float] | None = None
    lost: tuple[int, float] | None = None

    def crowd(self, random: np.random.Generator) -> Crowd:
        """Return the case's agents, in state 0."""
        world, count = self.world, self.count
        points = np.zeros((count, 3))
        if self.corner is not None:
            away = 10.0 ** random.uniform(-12, -1, count)
            aside = away * random.uniform(0.1, 0.9, count)
            points[:, :2] = self.corner + np.stack([-away, aside], axis=1)
        else:
            cells = np.argwhere(world.labels == 0)
            cell = cells[random.integers(len(cells), size=count), ::-1]
            place = cell + random.uniform(0.1, 0.9, (2, count)).T
            points[:, :2] = (world.area.x_min, world.area.y_min) + place * world.cell
        if self.lost is not None:
            points[:3, self.lost[0]] = self.lost[1]
        return replace(standing_crowd(points), wait=np.full(count, self.wait))


def table(states: dict, edge: str = "clamp", other: str = "wall") -> StateMachine:
    """Return a table of the labels "ground" and `other`."""
    labels = {"ground": {"color": "#808080"}, other: {"color": "#202020"}}
    told = {"version": 1, "edge": edge, "labels": labels, "states": states}
    return parse(json.dumps(told), "stiff case")


def turning(
    x: float,
    y: float,
    back: tuple[float, float] | None = None,
    edge: str = "clamp",
    chance: bool = False,
) -> StateMachine:
    """Return a table by which agents go along (x, y), m/s, and turn back at walls.

    back: m/s, where they go then; straight back if None.
    chance: whether they turn by chance, one time in two.
    """
    ways = {"out": [x, y], "back": [*(back or (-x, -y))]}
    states = {}
    for own, other in (("out", "back"), ("back", "out")):
        turn = {"next": {"out": 1, "back": 1} if chance else other, "move": ways[other]}
        states[own] = {
            "start": int(own == "out"),
            "on": {"ground": {"move": ways[own]}, "wall": turn},
        }
    return table(states, edge)


def going(x: float, y: float, edge: str = "clamp") -> StateMachine:
    """Return a table by which agents go along (x, y), m/s, everywhere."""
    return table({"go": {"on": {"*": {"move": [x, y]}}}}, edge)


def room(cell: float = 1.0, offset: float = 0.0) -> LabelMap:
    """Return SIZE by SIZE cells with walls all around."""
    labels = np.pad(np.zeros((SIZE - 2, SIZE - 2), np.uint8), 1, constant_values=1)
    return LabelMap(labels, Area(offset, offset, offset + SIZE * cell, offset + SIZE * cell))


def plain(rows: int, columns: int, stripes: bool = False) -> LabelMap:
    """Return cells of 1 m: ground, or ground and the other label by turns along x."""
    labels = np.tile(np.arange(columns) % 2 * stripes, (rows, 1)).astype(np.uint8)
    return LabelMap(labels, Area(0, 0, columns, rows))


def cases() -> list[StiffCase]:
    """Return the cases of steps."""
    hall, field, row = room(), plain(SIZE, SIZE), plain(1, SIZE)
    pair, stripes = plain(4, 2, stripes=True), plain(8, SIZE, stripes=True)
    # walls touch at their corners
    checks = LabelMap((1 - np.indices((6, 6)).sum(axis=0) % 2).astype(np.uint8), Area(0, 0, 6, 6))
    aslant = turning(*ASLANT)
    fast = turning(2400.0, 1800.0)
    another_way = turning(*ASLANT, (-1.0, -0.7578125))
    by_chance = turning(*ASLANT, chance=True)
    to_and_fro = table({"to": {"on": {"ground": {"move": [1, 0]}, "wall": {"move": [-1, 0]}}}})
    turns = {
        "ground": {"next": "b", "move": [24, 1]},
        "stripe": {"next": "b", "move": [24, -1]},
    }
    back = {"*": {"next": "a", "move": [24, 0]}}
    by_turns = table({"a": {"start": 1, "on": turns}, "b": {"on": back}}, "wrap", "stripe")
    ticks = table(
        {
            "a": {"start": 1, "after": 0.001, "then": "b", "on": {"*": {"move": [1, 0.5]}}},
            "b": {"after": 0.001, "then": "a", "on": {"*": {"move": [1, -0.5]}}},
        }
    )
    at_corner = partial(StiffCase, world=checks, bound=STANDS, corner=(3.0, 3.0))
    far, tiny = room(offset=1e8), room(cell=1e-6)
    reflected = turning(1440.0, 961.0, edge="reflect")
    small, large = (turning(size * ASLANT[0], size * ASLANT[1]) for size in (1e-3, 1e3))
    return [
        StiffCase("chatter: to and fro over a border", pair, to_and_fro),
        StiffCase("chatter: another state at each step", stripes, by_turns),
        at_corner("walls touch at a corner", machine=aslant, steps=8),
        at_corner("the same, 100 cells a step", machine=fast, steps=4),
        at_corner("the same, back another way", machine=another_way, count=FEW, steps=4),
        at_corner("the same, turns by chance", machine=by_chance, count=FEW, steps=4),
        StiffCase("60,000 cells a step", hall, turning(60_000 / FRAME, 0.0), FEW, steps=2),
        StiffCase("1,000,000 cells a step", hall, turning(1e6 / FRAME, 0.0), FEW),
        StiffCase("60 cells a step, reflected", field, reflected, FEW, steps=4),
        StiffCase("1e8 m from the origin", far, aslant),
        StiffCase("1e8 m from the origin, steps of 1e-9 s", far, aslant, FEW, 1e-9, 100),
        StiffCase("steps of 1e-9 s", hall, aslant, FEW, 1e-9, 100),
        StiffCase("a step of an hour", hall, aslant, FEW, 3600.0, 1),
        StiffCase("cells of 1e-6 m", tiny, aslant, FEW, FRAME / 8, 4),
        StiffCase("timers of 0.001 s", field, ticks, FEW, steps=4, wait=0.001),
        StiffCase("timers of 0.001 s, steps of 0.5 s", field, ticks, FEW, 0.5, 2, 2.0, wait=0.001),
        StiffCase("a map of one row, wrapped", row, going(3.0, 0.4, "wrap")),
        StiffCase("speeds of 1e-300 m/s", hall, going(1e-300, -1e-300)),
        StiffCase("a map a step", row, going(SIZE / FRAME, 0.0, "wrap")),
        StiffCase("first frame -1e6", hall, aslant, first=-1_000_000),
        StiffCase("unit scale 0.001", room(cell=1e-3), small),
        StiffCase("unit scale 1000", room(cell=1e3), large),
        *(
            StiffCase(f"three agents at {value} in {'xy'[axis]}", hall, aslant, lost=(axis, value))
            for axis, value in product(range(2), (np.nan, np.inf))
        ),
    ]


def judge_steps(case: StiffCase, random: np.random.Generator) -> Iterator[BoundedError]:
    """Yield what is wrong after the case's steps."""
    crowd = case.crowd(random)
    world = case.world
    placed = np.flatnonzero(np.isfinite(crowd.x) & np.isfinite(crowd.y))
    start = crowd.of(placed)
    walk = Walk(crowd, case.machine, world, (PERSON,), case.seconds, case.first)
    try:
        for step in range(1, case.steps + 1):
            crowd = walk.at(case.first + step)
    except CrowdError:
        is_fast = courant(case.machine, world, case.seconds).max() > MOST_CELLS
        yield BoundedError(case.name, "steps refused, other than for their speed", not is_fast, 0)
        return
    truth = follow_exactly(start, case.machine, world, case.seconds, case.steps)
    crowd = crowd.of(placed)
    away = offsets(crowd, truth, walk)[:, ~truth.unknown]
    cells = away / np.array(world.cell)[:, None]
    broken = int(_is_broken(case, crowd, start).sum())
    yield BoundedError(case.name, "agents broken", broken, 0)
    yield BoundedError(case.name, "off by cells", float(cells.max(initial=0)), case.bound)


def _is_broken(case: StiffCase, crowd: Crowd, start: Crowd) -> np.ndarray:
    """Return (n,) bool: agents that are nowhere, off the map, in a wall, or walled off from their
    start.

    An agent may stand on the border of a wall, which counts as the ground beside it.
    """
    world = case.world
    walls = np.array([label == "wall" for label in case.machine.labels])[world.labels]
    regions = _regions(walls)
    home = regions[world.cells(start.x, start.y)[::-1]]
    width, depth = world.cell
    within = np.zeros(len(crowd), bool)
    # the cells that an agent touches
    for aside, along in product((-ROUNDING, ROUNDING), repeat=2):
        column, row = world.cells(crowd.x + aside * width, crowd.y + along * depth)
        within |= regions[row, column] == home
    area = world.area
    for at, low, high in ((crowd.x, area.x_min, area.x_max), (crowd.y, area.y_min, area.y_max)):
        within &= (at >= low) & (at <= high)
    return ~within


def _regions(walls: np.ndarray) -> np.ndarray:
    """Return (rows, columns) intp, the region of each cell: those alike that share their sides."""
    numbers = np.arange(walls.size).reshape(walls.shape)
    pairs = []
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        alike = walls[one] == walls[other]
        pairs.append(np.stack([numbers[one][alike], numbers[other][alike]], axis=1))
    return connected_components(walls.size, np.concatenate(pairs)).reshape(walls.shape)
