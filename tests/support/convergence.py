"""How the error of steps falls with their length, beside the judge's limit of ever shorter ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.step import step
from crowd_lod_extension.crowd_lod.crowd.agents import Crowd
from crowd_lod_extension.crowd_lod.crowd.state_machine import StateMachine
from crowd_lod_extension.crowd_lod.validation.exact_behavior import ExactPlaces
from crowd_lod_extension.crowd_lod.world.maps import LabelMap


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
