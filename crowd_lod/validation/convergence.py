"""Measures of steps against the slow judge: convergence and drift."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..behavior.step import step
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap
from .exact_behavior import ExactPlaces

AGENTS = 64  # whose drift is measured
UNITS = 2.0**100  # a meter has: any double above 2e-15 m is a whole number of them


def step_by_listing(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd after one step of listing 1.1 to the letter, for comparison.

    One read and one move of any length, through walls too, clamped to the map, without timers.
    """
    label = world.at(crowd.x, crowd.y)
    velocity = machine.velocity[crowd.state, label]
    area = world.area
    x = np.clip(crowd.x + velocity[:, 0] * seconds, area.x_min, area.x_max)
    y = np.clip(crowd.y + velocity[:, 1] * seconds, area.y_min, area.y_max)
    return replace(crowd, x=x, y=y, state=machine.following(crowd.state, label, crowd.key))


@dataclass(frozen=True)
class Convergence:
    """The error of stepping against the limit of ever shorter steps.

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
        return (
            float(np.polyfit(np.log(self.dt[real]), np.log(self.mean[real]), 1)[0])
            if real.sum() > 1
            else np.nan
        )


def measure_convergence(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    limit: ExactPlaces,
    steps: Sequence[int] = (16, 32, 64, 128, 256, 512),
    method: Callable[..., Crowd] = step,
) -> Convergence:
    """Measure the position error against the judge's limit of ever shorter steps.

    limit: the places in the end, from follow_exactly.
    steps: numbers of equal steps to try.
    method: `step` or `step_by_listing`.

    Agents that chatter, and those on which the judge gave up, are left out. On a map that wraps,
    the shorter way round counts.
    """
    seconds = limit.seconds
    compared = ~(limit.chatters | limit.unknown)
    rows = []
    for count in steps:
        moved = crowd
        for _ in range(count):
            moved = method(moved, machine, world, seconds / count)
        off = np.abs(np.stack([moved.x - limit.x, moved.y - limit.y]))[:, compared]
        if machine.edge == "wrap":
            off = np.minimum(off, np.array(world.area.size)[:, None] - off)
        error = np.hypot(*off) if off.size else np.zeros(1)
        rows.append(
            (np.median(error), error.mean(), error.max(), (error > np.hypot(*world.cell)).mean())
        )
    median, mean, worst, apart = np.array(rows).T
    return Convergence(seconds / np.array(steps), median, mean, worst, apart, int(compared.sum()))


def measure_drift(
    dtype: type[np.floating] = np.float64,
    steps: int = 1_000_000,
    offset: float = 0.0,
) -> tuple[float, float]:
    """Return (mean, worst) position error in meters after `steps` steps in `dtype`.

    The reference is the exact sum. The agents walk straight for 1,000 steps at a time, at 0.5 to 2
    m/s drawn anew for each stretch, to and fro within some 100 m of `offset`. Each step rounds x +
    v dt once, as `step` does; the exact sum of the same v dt never rounds.

    After 1e6 steps (11.6 hours at 24 frames a second), mean and worst of the agents:
        float64   at the origin 2.9e-11 and 7.6e-11 m   at 10 km 1.4e-8 and 4.1e-8 m
        float32   at the origin 0.013 and 0.045 m       at 10 km 7.4 and 21.8 m
    So positions are float64. Float32 would save 12 of 49 bytes an agent, and lose centimeters at
    the origin and the whole scene far from it. The float64 error is far below a pixel of any
    picture, so storing the start and time of every straight stretch, to form start + velocity *
    time, would gain nothing.
    """
    random = np.random.default_rng(0)
    x = (offset + random.uniform(-25, 25, AGENTS)).astype(dtype)
    exact = _whole(x)
    while steps > 0:
        count = min(steps, 1000)
        steps -= count
        way = np.where(
            np.abs(x - offset) > 25, np.sign(offset - x), random.choice((-1.0, 1.0), AGENTS)
        )
        stride = (way * random.uniform(0.5, 2.0, AGENTS) / 24).astype(dtype)
        x = np.add.accumulate(
            np.concatenate([x[None], np.broadcast_to(stride, (count, AGENTS))]), axis=0, dtype=dtype
        )[-1]
        exact += count * _whole(stride)
    error = np.abs(_whole(x) - exact).astype(np.float64) / UNITS
    return float(error.mean()), float(error.max())


def _whole(meters: np.ndarray) -> np.ndarray:
    """Return lengths (n,) in 1 / UNITS of a meter, as Python's integers, which never round."""
    return np.array([int(length * UNITS) for length in meters.tolist()], object)
