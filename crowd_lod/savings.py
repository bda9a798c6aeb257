"""How many milliseconds each thing that a scene does not need saves, measured."""

import threading
import time as clock
from dataclasses import dataclass, replace

import numpy as np

from .behaviour import Trajectory
from .frame import plan
from .lean import ALL, NO_HEIGHTS, NOTHING, LeftOut
from .maps import HeightMap


@dataclass(frozen=True)
class Savings:
    """Medians over the repeats. full, lean: milliseconds of a frame's plan, its step of behaviour included. items: the
    milliseconds that each thing saves where it alone is left out: where several spare the same work their sum is more
    than all save together."""

    full: float
    lean: float
    items: dict[LeftOut, float]


def savings(trajectory: Trajectory, camera, policy, time: float, *more, repeats: int = 3) -> Savings:
    """Measures the plan of `time`, a frame after the first; arguments as for frame.plan. The crowd is not moved."""
    start, first = trajectory.at(time - 1), trajectory.first_frame

    def fresh(leave):
        """The shot from the frame before on, which it has planned already."""
        shot = replace(trajectory, start=start, leave=leave, first_frame=time - 2, _kept={}, _lock=threading.Lock())
        plan(shot, camera, policy, time - 1, *more)
        return shot

    del first
    lean = plan(fresh(ALL), camera, policy, time, *more).left_out
    choices = [NOTHING, ALL, *(frozenset([item]) for item in lean)]
    took = np.empty((repeats, len(choices)))
    for repeat in range(repeats):
        for k, leave in enumerate(choices):
            shot = fresh(leave)
            begun = clock.perf_counter()
            plan(shot, camera, policy, time, *more)
            took[repeat, k] = 1000 * (clock.perf_counter() - begun)
    full, least, *alone = (float(ms) for ms in np.median(took, axis=0))
    return Savings(full, least, {item: full - ms for item, ms in zip(lean, alone, strict=True)})
