"""Measured milliseconds that each left out part of the work saves."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..crowd.leave_outs import ALL, ITEMS, STATIC, STILL, LeftOut
from ..culling.camera import Camera
from ..frame.frame import Frame, plan
from ..frame.index_cache import blocks_at
from ..levels.assignment import LevelPolicy
from ..sources.trajectory import Trajectory


@dataclass(frozen=True)
class Savings:
    """Medians over repeats, in milliseconds.

    full, lean: the four stages of a frame without and with all leave-outs. Behavior is one single
        step: a walk's look-ahead serves many frames and would hide what an item saves.
    items: what each item saves when those before it are left out already. Together they are about
        full - lean.
    spread: half of the interquartile range of each. A saving below it is below the clock's
        precision.
    """

    full: float
    lean: float
    items: dict[LeftOut, float]
    spread: dict[LeftOut, float]


def plan_leaving(
    leave: frozenset[LeftOut],
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: int,
    *more: Any,
) -> Frame:
    """Return the frame at `time` of a shot that has just begun and leaves out `leave`.

    time: in frames, two or more after the first.
    The other arguments are those of `plan` (frame/frame.py).
    """
    settled = STILL in leave & trajectory.left_out  # a settled crowd needs a planned frame before
    first = time - 2 if settled else time - 1
    shot = trajectory.leaving(leave, first)
    blocks_at(shot, first)  # made before the clock starts, since blocks serve many frames
    if settled:
        plan(shot, camera, policy, time - 1, *more)
    return plan(shot, camera, policy, time, *more)


def savings(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: int,
    *more: Any,
    repeats: int = 9,
) -> Savings:
    """Return what is saved in the plan of the frame at `time`.

    time: in frames, two or more after the first.
    The other arguments are those of `plan` (frame/frame.py).
    """

    def measured(leave: frozenset[LeftOut]) -> tuple[np.ndarray, tuple[LeftOut, ...]]:
        """Return (milliseconds of behavior and of the rest, what was left out)."""
        frame = plan_leaving(leave, trajectory, camera, policy, time, *more)
        behavior, *rest = frame.milliseconds.values()
        return np.array([behavior, sum(rest)]), frame.left_out

    left_out = set(measured(ALL)[1])
    # a plan that holds leaves nothing else to save: it comes last
    order = sorted((item for item in ITEMS if item in left_out), key=lambda item: item is STATIC)
    choices = [frozenset(order[:k]) for k in range(len(order) + 1)]
    took = np.array([[measured(leave)[0] for leave in choices] for _ in range(repeats)])
    quarters = {}
    for k, item in enumerate(order):
        # only the part in which an item can save anything counts: the other is the clock's noise
        part = 0 if item.stage == "behavior" else 1
        quarters[item] = np.percentile(took[:, k, part] - took[:, k + 1, part], (25, 50, 75))
    quarters = {item: quarters[item] for item in ITEMS if item in quarters}
    full, lean = np.median(took[:, [0, -1]].sum(axis=2), axis=0)
    return Savings(
        float(full),
        float(lean),
        {item: float(middle) for item, (_, middle, _) in quarters.items()},
        {item: float(high - low) / 2 for item, (low, _, high) in quarters.items()},
    )
