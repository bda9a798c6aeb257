"""How many milliseconds each thing that a scene does not need saves, measured."""

import threading
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .behaviour import Trajectory
from .camera import Camera
from .frame import plan
from .lean import ALL, ITEMS, NO_HEIGHTS, STATIC, STILL, LeftOut
from .levels import LevelPolicy
from .maps import HeightMap


@dataclass(frozen=True)
class Savings:
    """Medians over repeats, milliseconds. full, lean: a frame's four stages, with one step of behaviour. items: what each
    thing left out saves when those before it are left out already, so that they add up to full - lean; but for the height
    map, which the full pipeline does not have either: what the look-up on a level one would cost."""

    full: float
    lean: float
    items: dict[LeftOut, float]


def savings(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: float,
    *more,
    repeats: int = 3,
) -> Savings:
    """Measures the plan of the frame at `time`, two frames after the first or later; arguments as for frame.plan."""
    start = trajectory.at(time - 1)
    bare = start if trajectory.heights is None else replace(start, z=trajectory.start.z)

    def measured(leave: frozenset[LeftOut]) -> tuple[np.ndarray, tuple[LeftOut, ...]]:
        """(milliseconds of behaviour and of the rest, what was left out) of the frame."""
        settled = STILL in leave & trajectory.left_out  # then it follows one that was planned
        first = time - 2 if settled else time - 1
        shot = replace(trajectory, start=bare, leave=leave, first_frame=first, _kept={}, _lock=threading.Lock())
        shot.left_out = leave & trajectory.left_out  # of the whole shot, not of what is still to come
        if settled:
            plan(shot, camera, policy, time - 1, *more)
        frame = plan(shot, camera, policy, time, *more)
        behaviour, *rest = frame.milliseconds.values()
        return np.array([behaviour, sum(rest)]), frame.left_out

    found = set(measured(ALL)[1])
    order = [item for item in ITEMS if item in found and item not in (STATIC, NO_HEIGHTS)] + [STATIC] * (STATIC in found)
    choices = [frozenset(order[:k]) for k in range(len(order) + 1)]
    took = np.median([[measured(leave)[0] for leave in choices] for _ in range(repeats)], axis=0)
    gained = took[:-1] - took[1:]
    # each where it can save anything: the other part is the clock's noise
    items = {item: float(ms[0] if item.stage == "behaviour" else ms[1]) for item, ms in zip(order, gained, strict=True)}
    if NO_HEIGHTS in found:
        items[NO_HEIGHTS] = _look_up(trajectory, repeats)
    return Savings(float(took[0].sum()), float(took[-1].sum()), {item: items[item] for item in ITEMS if item in items})


def _look_up(trajectory: Trajectory, repeats: int) -> float:
    """Median milliseconds of finding the height of every agent on a height map."""
    level = HeightMap(np.zeros((256, 256), np.float32), trajectory.world.area)
    took = []
    for _ in range(repeats):
        begun = clock.perf_counter()
        level.at(trajectory.start.x, trajectory.start.y)
        took.append(1000 * (clock.perf_counter() - begun))
    return float(np.median(took))
