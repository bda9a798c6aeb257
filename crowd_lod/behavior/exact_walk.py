"""The exact walk, and measures against it: convergence, drift, agents in trouble.

Between two cell borders an agent walks straight at constant velocity, so its way is piecewise
linear and known exactly. The exact walk is the limit of listing 1.1 for ever shorter steps. An
agent reads the table until its state no longer changes, then walks to the next border. Between two
reads it does not move, with one exception: a rule that heads out over the border on which the agent
stands, as a wall's rule does, moves it out.

A step (behavior/step.py) reads once in each piece. So the two agree, up to rounding, wherever a
rule moves as the state that it leads to. Elsewhere an agent keeps the rule's own velocity for at
most a step, and the error is of first order in the step.

Some tables have no limit. One that turns an agent a little at each read, first further in and then
out again (the plaza's, along its houses), lets the agent out after one read more or less, depending
on where in a step it reached the border, however short the step. The exact walk takes the first way
out. Such agents are equally far apart with any step: see Convergence.apart.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from ..format import counted
from .step import advance, step


def walk(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> tuple[Crowd, np.ndarray]:
    """Return (crowd, chatters) `seconds` later, exact up to the rounding of float64.

    The error is a few units in the last place per border.

    chatters: (n,) bool, agents whose state the table changes for ever in one place, so that time
        cannot go on: to and fro over a border, or in a cycle on one label. They stay there. Their
        state is any of those in the cycle. If the states of a cycle move agents, their place is not
        a limit of the steps' places. With random choices, a long enough row of changes counts as
        for ever. Agents between walls that touch at a corner and leave nearly no room are included.
    """
    moved, tally = advance(crowd, machine, world, seconds, exact=True)
    return moved, tally.held


def listing(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd after one step of listing 1.1 to the letter, for comparison.

    One read and one move of any length, through walls too, clamped to the map, without timers.
    """
    label = world.at(crowd.x, crowd.y)
    velocity, area = machine.velocity[crowd.state, label], world.area
    x = np.clip(crowd.x + velocity[:, 0] * seconds, area.x_min, area.x_max)
    y = np.clip(crowd.y + velocity[:, 1] * seconds, area.y_min, area.y_max)
    return replace(crowd, x=x, y=y, state=machine.following(crowd.state, label, crowd.key))


@dataclass(frozen=True)
class Convergence:
    """The error of stepping against the exact walk.

    dt: (k,) seconds.
    median, mean, worst: (k,) meters, over the agents compared.
    apart: (k,), the share of these agents that end more than a cell's diagonal away.
    agents: the number of agents compared.
    """

    dt: np.ndarray
    median: np.ndarray
    mean: np.ndarray
    worst: np.ndarray
    apart: np.ndarray
    agents: int

    @property
    def order(self) -> float:
        """Return the order of convergence: the slope of log error against log dt.

        Least squares over the mean errors above rounding; NaN with fewer than two of them.
        """
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
    """Measure the position error after `seconds` against the exact walk.

    steps: numbers of equal steps to try.
    method: `step` or `listing`.

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
    median, mean, worst, apart = np.array(rows).T
    return Convergence(seconds / np.array(steps), median, mean, worst, apart, int((~chatters).sum()))


def drift(
    dtype: type[np.floating] = np.float64,
    steps: int = 1_000_000,
    agents: int = 64,
    seconds: float = 1 / 24,
    offset: float = 0.0,
    seed: int = 0,
) -> tuple[float, float]:
    """Return (mean, worst) position error in meters after `steps` steps in `dtype`.

    The reference is the exact sum. The agents walk straight for 1,000 steps at a time, at 0.5 to 2
    m/s drawn anew for each stretch, to and fro within some 100 m of `offset`. Each step rounds x +
    v dt once, as `step` does; the exact sum of the same v dt never rounds.

    After 1e6 steps (11.6 hours at 24 frames a second), mean and worst of 64 agents:
        float64   at the origin 2.9e-11 and 7.6e-11 m   at 10 km 1.4e-8 and 4.1e-8 m
        float32   at the origin 0.013 and 0.045 m       at 10 km 7.4 and 21.8 m
    So positions are float64. Float32 would save 12 of 49 bytes an agent, and lose centimeters at
    the origin and the whole scene far from it. The float64 error is far below a pixel of any
    picture, so storing the start and time of every straight stretch, to form start + velocity *
    time, would gain nothing.
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

    kind: "chatters": the state changes for ever and the agent gets nowhere, or nearly so. "stuck":
        the agent stands for good in a state that walks elsewhere.
    agents: (k,) intp.
    x, y: (p,) float64 world meters, centers of the map cells where the agents are.
    column, row: (p,) intp, these cells; row 0 lies at y_min.
    counts: (p,), agents in each cell, largest first.
    """

    kind: str
    agents: np.ndarray
    x: np.ndarray
    y: np.ndarray
    column: np.ndarray
    row: np.ndarray
    counts: np.ndarray

    def __str__(self) -> str:
        one, many = {
            "chatters": ("agent changes state endlessly and stays in place", "agents change state endlessly and stay in place"),
            "stuck": ("agent stands for good", "agents stand for good"),
        }[self.kind]
        where = f"most of them ({self.counts[0]}) at" if len(self.counts) > 1 else "at"
        return (
            f"{counted(len(self.agents), one, many)}, {where} x {self.x[0]:.2f} m, y {self.y[0]:.2f} m "
            f"(map column {self.column[0]}, row {self.row[0]} from the bottom)."
        )


def trouble(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float = 60.0) -> tuple[Trouble, ...]:
    """Return the troubles that `crowd` is in or walks into within `seconds`.

    Returns at most one Trouble of each kind, () if all is well.

    Both kinds are read from the exact walk, so they are certain, not guessed from a few frames. A
    stuck agent does not move, does not change state and does not wait for a timer. An agent in a
    state that never moves and never ends, on any label, rests there by design and is not counted.
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
    return Trouble(kind, agents, *world.middles(row, column), column, row, counts[most])
