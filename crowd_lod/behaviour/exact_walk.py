"""The exact walk, and what is measured against it: order of convergence, drift, and agents in trouble.

Between two cell borders an agent walks straight at a constant velocity, so its way is piecewise linear and known exactly.
The exact walk is what listing 1.1 tends to as its steps become short: an agent reads the table until its state no
longer changes, and only then walks to the next border; between two reads it moves not at all, but for this: if a
rule heads out over the border that it stands on, as that of a wall does, it is out. A step (behaviour/step.py) reads once in each
piece, so the two agree, but for rounding, wherever a rule moves as the state that it leads to does; elsewhere an agent keeps
the rule's own velocity for at most a step, and the error is of first order in the step.

Some tables have no limit: one that turns an agent a little at each read, first further in and then out again (the plaza's,
along its houses), lets it out after one read more or less, depending on where in a step it came to the border, however
short the step. The exact walk takes the first way out. Such agents are as far apart with any step: see `apart`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from .step import advance, step


def walk(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float):
    """(crowd, chatters) `seconds` later, exact but for the rounding of float64, a few units in the last place a border.

    chatters: (n,) bool, agents that came to a place where the table changes their state for ever and time cannot go on:
    to and fro over a border, or in a cycle on one label. They stay there; their state is any of those they change
    between, and their place is not a limit of the steps' if the states of a cycle move them on. (With random choices
    a long enough row of changes counts as for ever.) So do agents between walls that leave them next to no room, where
    they touch at a corner: they go to and fro there in equal rounds, or stand (borders.Rounds).
    """
    moved, tally = advance(crowd, machine, world, seconds, exact=True)
    return moved, tally.held


def listing(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Listing 1.1 to the letter: one read and one move of any length, walls or not; clamped to the map. It knows no
    timers. For comparison only."""
    label = world.at(crowd.x, crowd.y)
    velocity, area = machine.velocity[crowd.state, label], world.area
    x = np.clip(crowd.x + velocity[:, 0] * seconds, area.x_min, area.x_max)
    y = np.clip(crowd.y + velocity[:, 1] * seconds, area.y_min, area.y_max)
    return replace(crowd, x=x, y=y, state=machine.following(crowd.state, label, crowd.key))


@dataclass(frozen=True)
class Convergence:
    """Error of stepping against the exact walk. dt: (k,) seconds; median, mean, worst: (k,) metres over the agents
    compared; apart: (k,) the share of them that ended more than a cell's diagonal away; agents: how many are compared."""

    dt: np.ndarray
    median: np.ndarray
    mean: np.ndarray
    worst: np.ndarray
    apart: np.ndarray
    agents: int

    @property
    def order(self) -> float:
        """The slope of log error against log dt, least squares over the mean errors above rounding; nan if there are
        not two."""
        real = self.mean > 1e-9
        return float(np.polyfit(np.log(self.dt[real]), np.log(self.mean[real]), 1)[0]) if real.sum() > 1 else np.nan


def convergence(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    steps: Sequence[int] = (16, 32, 64, 128, 256, 512),
    method: Callable[..., Crowd] = step,
) -> Convergence:
    """Position error after `seconds` in so many equal `steps` of `method` (`step` or `listing`), against the exact walk.

    Agents that chatter are left out. On a map that wraps, the shorter way round counts.
    """
    exact, chatters = walk(crowd, machine, world, seconds)
    rows = []
    for count in steps:
        moved = crowd
        for _ in range(count):
            moved = method(moved, machine, world, seconds / count)
        off = np.abs(np.stack([moved.x - exact.x, moved.y - exact.y]))[:, ~chatters]
        if machine.edge == "wrap":
            off = np.minimum(off, np.array(world.area.size)[:, None] - off)
        error = np.hypot(*off) if off.size else np.zeros(1)
        rows.append((np.median(error), error.mean(), error.max(), (error > np.hypot(*world.cell)).mean()))
    return Convergence(seconds / np.array(steps), *np.array(rows).T, int((~chatters).sum()))


def drift(
    dtype=np.float64, steps: int = 1_000_000, agents: int = 64, seconds: float = 1 / 24, offset: float = 0.0, seed: int = 0
) -> tuple[float, float]:
    """(mean, worst) position error in metres after `steps` steps with positions kept in `dtype`, against exact sums.

    The agents walk straight for 1,000 steps at a time, at 0.5 to 2 m/s drawn anew for each stretch, to and fro within
    some 100 m of `offset`. Each step rounds x + v dt once, as `step` does; the exact sum of the same v dt rounds never.

    After 1e6 steps (11.6 hours at 24 frames a second), mean and worst of 64 agents:
        float64   at the origin 2.9e-11 and 7.6e-11 m   at 10 km 1.4e-8 and 4.1e-8 m
        float32   at the origin 0.013 and 0.045 m       at 10 km 7.4 and 21.8 m
    So positions are float64: float32 would save 12 of 51 bytes an agent, and lose centimetres at the origin and the whole
    scene far from it. In float64 the error is far below a pixel of any picture, so nothing is gained by keeping the start
    and the time of every straight stretch besides, to form start + velocity * time instead of the sum.
    """
    random = np.random.default_rng(seed)
    x = (offset + random.uniform(-25, 25, agents)).astype(dtype)
    exact = [Fraction(value) for value in x.tolist()]
    while steps > 0:
        count = min(steps, 1000)
        steps -= count
        way = np.where(np.abs(x - offset) > 25, np.sign(offset - x), random.choice((-1.0, 1.0), agents))
        stride = (way * random.uniform(0.5, 2.0, agents) * seconds).astype(dtype)
        x = np.add.accumulate(np.concatenate([x[None], np.broadcast_to(stride, (count, agents))]), axis=0, dtype=dtype)[-1]
        exact = [place + count * Fraction(each) for place, each in zip(exact, stride.tolist(), strict=True)]
    error = np.array([abs(float(Fraction(end) - place)) for end, place in zip(x.tolist(), exact, strict=True)])
    return float(error.mean()), float(error.max())


@dataclass(frozen=True)
class Trouble:
    """Agents that the table and the map have caught.

    kind: "chatters", the state changes for ever and the agent gets nowhere, or next to; or "stuck", it stands for good in a state
    that walks elsewhere. agents: (k,) intp. x, y: (p,) float64, the middles of the map's cells where they are, world
    metres; column, row: (p,) intp, those cells, row 0 at y_min; counts: (p,) agents in each, the most first.
    """

    kind: str
    agents: np.ndarray
    x: np.ndarray
    y: np.ndarray
    column: np.ndarray
    row: np.ndarray
    counts: np.ndarray

    def __str__(self) -> str:
        says = {"chatters": "change state for ever and get nowhere", "stuck": "stand for good"}[self.kind]
        where = f"most of them ({self.counts[0]}) at" if len(self.counts) > 1 else "at"
        return (
            f"{len(self.agents)} agents {says}, {where} x {self.x[0]:.2f} m, y {self.y[0]:.2f} m "
            f"(map column {self.column[0]}, row {self.row[0]} from the bottom)."
        )


def trouble(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float = 60.0) -> tuple[Trouble, ...]:
    """The troubles that `crowd` is in, or walks into within `seconds`, each kind at most once; () if all is well.

    Both are read from the exact walk, so they are found with certainty, not guessed from a few frames. An agent is stuck
    that neither moves, nor changes state, nor waits for a timer; those in a state that never moves and never ends, on
    whatever label, rest there by design and are not counted.
    """
    later, chatters = walk(crowd, machine, world, seconds)
    again, more = walk(later, machine, world, seconds / 60)
    chatters |= more
    still = (again.x == later.x) & (again.y == later.y) & (again.state == later.state) & (again.mirror == later.mirror)
    own = np.arange(len(machine.states))[:, None]
    stays = (machine.next_state == own) & (machine.next_choice < 0) & ~machine.velocity.any(axis=2)
    rests = stays.all(axis=1) & ~np.isfinite(machine.after[:, 0])
    stuck = still & ~chatters & np.isinf(later.wait) & ~rests[later.state]
    found = (_places(kind, caught, later, world) for kind, caught in (("chatters", chatters), ("stuck", stuck)))
    return tuple(each for each in found if len(each.agents))


def _places(kind: str, caught: np.ndarray, crowd: Crowd, world: LabelMap) -> Trouble:
    agents = np.flatnonzero(caught)
    columns = world.labels.shape[1]
    column, row = world.cells(crowd.x[agents], crowd.y[agents])
    cells, counts = np.unique(row * columns + column, return_counts=True)
    most = np.argsort(-counts, kind="stable")
    row, column = np.divmod(cells[most], columns)
    x, y = world.area.x_min + (column + 0.5) * world.cell[0], world.area.y_min + (row + 0.5) * world.cell[1]
    return Trouble(kind, agents, x, y, column, row, counts[most])
