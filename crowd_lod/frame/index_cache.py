"""Caches of a crowd between frames: its blocks, and the plan of a still crowd.

Caches, never the truth: a plan is the same whichever frame was asked for before it. To that end
boxes are computed at every `Trajectory.every`-th frame, and the order of the agents in them at
every PART-th of those frames.

Blender may ask from several threads, a viewport's and a render's, without a lock. So each cache is
one tuple: the frame that it was filled for, and the result. It is read once, replaced as a whole,
and its arrays are never written to. A thread that finds the cache filled for another frame computes
its own result. Two threads may compute the same frame twice; neither ever returns the other's.

No cache refers to its Trajectory, which would never be freed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..crowd.bounds import STANDING, VelocityBounds
from ..culling import blocks
from ..sources.trajectory import PART, Trajectory
from ..world import morton_order

# Blocks may be asked for so many frames before they are computed, or after the next ones are: a
# shutter opens and closes around its frame.
SHUTTER = 2


@dataclass
class TrajectoryCache:
    """The caches of one trajectory.

    boxes: (frame, the blocks at that frame).
    order: (frame, (n,) int32 agents in block order).
    memo: of frame.plan_of.
    """

    boxes: tuple[int, blocks.Blocks] | None = None
    order: tuple[int, np.ndarray] | None = None
    memo: Any = None


_CACHES: WeakKeyDictionary[Trajectory, TrajectoryCache] = WeakKeyDictionary()


def cache_of(trajectory: Trajectory) -> TrajectoryCache:
    """Return the caches of the `trajectory`, which live as long as it does."""
    cache = _CACHES.get(trajectory)
    if cache is None:
        cache = _CACHES[trajectory] = TrajectoryCache()
    return cache


def blocks_at(trajectory: Trajectory, time: float) -> tuple[int, blocks.Blocks] | None:
    """Return (frame at which they were computed, the crowd's blocks) for `time`, in frames.

    None for a small crowd (morton_order.FEWEST), and for one whose velocity is not known. Call
    trajectory.at for this time first.
    """
    if len(trajectory.start) < morton_order.FEWEST:
        return None
    first = trajectory.first_frame
    frame = int(max(time - first, 0.0))
    if trajectory.still:
        frame = min(frame, 1)  # two serve all frames: of the start, and of the only step
    else:
        frame -= frame % trajectory.every
    if _velocity(trajectory, first + frame) is None:
        return None
    cache = cache_of(trajectory)
    boxes = cache.boxes
    if boxes is None or boxes[0] != first + frame:
        boxes = cache.boxes = None  # freed before the next ones take memory
        boxes = cache.boxes = first + frame, _compute_blocks(trajectory, frame)
    return boxes


def _compute_blocks(trajectory: Trajectory, frame: int) -> blocks.Blocks:
    """Return the blocks at a whole `frame`, counted from 0."""
    every = trajectory.every
    velocity = _velocity(trajectory, trajectory.first_frame + frame) or STANDING
    seconds = [frames * trajectory.seconds_per_frame for frames in (-SHUTTER, every + SHUTTER)]
    wraps = velocity.between(seconds) if trajectory.wraps else None
    span = (-np.inf, np.inf) if trajectory.heights is None else trajectory.heights.span
    return blocks.blocks_of(
        trajectory.kept_at(frame),
        _order_at(trajectory, frame - frame % (PART * every)),
        trajectory.spheres,
        trajectory.area,
        wraps,
        span if velocity.climbs else None,
    )


def _order_at(trajectory: Trajectory, frame: int) -> np.ndarray:
    """Return the agents in block order at a whole `frame`, counted from 0."""
    cache = cache_of(trajectory)
    order = cache.order
    if order is None or order[0] != frame:
        order = cache.order = None
        crowd = trajectory.kept_at(frame)
        agents = morton_order.order_of(crowd.x, crowd.y, crowd.group, trajectory.area)
        order = cache.order = frame, agents
    return order[1]


def _velocity(trajectory: Trajectory, since: int) -> VelocityBounds | None:
    """Return bounds of the velocity while blocks computed at frame `since` may be asked for.

    None if not known.
    """
    return trajectory.velocity(since - SHUTTER, since + trajectory.every + SHUTTER)


def displacement_of(
    trajectory: Trajectory, time: float, since: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (least, most) displacement, (3,) meters, of agents since their blocks.

    time: now; since: when the blocks were computed; both in frames. Infinite where the blocks do
        not hold.
    """
    frames = max(time, trajectory.first_frame) - since
    velocity = _velocity(trajectory, since)
    holds = trajectory.still or -SHUTTER <= frames <= trajectory.every + SHUTTER
    if velocity is None or not holds:
        return np.full(3, -np.inf), np.full(3, np.inf)
    return velocity.between([frames * trajectory.seconds_per_frame])


def approach(trajectory: Trajectory, time: float) -> Iterator[float]:
    """Compute the crowd and its blocks at `time`, in frames, so that they are cached.

    Yields the progress, 0 to 1, where that takes long. It may be closed at any time.
    """
    return trajectory.approach(time, partial(blocks_at, trajectory, time))
