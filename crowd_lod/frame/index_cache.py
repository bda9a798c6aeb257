"""What the planner keeps of a crowd between frames: its blocks, and the last plan where nothing
moves.

Caches, never the truth.

Boxes of blocks are made anew every `Trajectory.every` frames, and the order of the agents in them
every ORDERED makings: always at the same frames, so that a plan is the same whichever frame came
before.

Blender may ask from several threads, a viewport's and a render's, without a lock: whatever is kept
is one tuple with what it was made for, read once and replaced as a whole, of values that nobody
writes to afterwards. Who finds another frame's makes its own and answers with that, so that two
threads may make the same at once, and no answer is another's. What is kept holds no Trajectory: it
would never let that go.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..crowd import morton_order
from ..crowd.leave_outs import STILL
from ..crowd.velocity_bounds import STANDING, VelocityBounds
from ..culling import blocks
from ..sources.trajectory import PART as ORDERED
from ..sources.trajectory import Trajectory

SHUTTER = 2  # frames beyond those between two makings of the blocks at which they may be asked for


@dataclass
class Kept:
    """The caches of one trajectory.

    boxes: (frame, the blocks made then).
    order: (frame, the agents in order).
    memo: of frame.plan_of.
    """

    boxes: tuple[int, blocks.Blocks] | None = None
    order: tuple[int, np.ndarray] | None = None
    memo: Any = None


_KEPT: WeakKeyDictionary[Trajectory, Kept] = WeakKeyDictionary()


def kept_of(trajectory: Trajectory) -> Kept:
    """Return the caches of the `trajectory`, which live as long as it does."""
    kept = _KEPT.get(trajectory)
    if kept is None:
        kept = _KEPT[trajectory] = Kept()
    return kept


def blocks_at(trajectory: Trajectory, time: float) -> tuple[int, blocks.Blocks] | None:
    """Return (frame when they were made, the crowd's blocks) for `time`, in frames.

    None for a small crowd (morton_order.FEWEST), and for one whose velocity is not known. Call
    trajectory.at for this time first.
    """
    if len(trajectory.start) < morton_order.FEWEST:
        return None
    kept = kept_of(trajectory)
    every = trajectory.every
    first = trajectory.first_frame
    frame = int(max(time - first, 0.0))
    frame = min(frame, 1) if STILL in trajectory.left_out else frame - frame % every
    if _velocity(trajectory, first + frame) is None:
        return None
    made = kept.boxes
    if made is None or made[0] != first + frame:
        made = kept.boxes = None  # let go before others are made
        made = kept.boxes = first + frame, _made(trajectory, frame)
    return made


def _made(trajectory: Trajectory, frame: int) -> blocks.Blocks:
    """Make the blocks at a whole `frame`, counted from 0."""
    kept = kept_of(trajectory)
    every = trajectory.every
    area = trajectory.area
    velocity = _velocity(trajectory, trajectory.first_frame + frame) or STANDING
    since = frame - frame % (ORDERED * every)
    order = kept.order
    if order is None or order[0] != since:
        order = kept.order = None
        crowd = trajectory.kept_at(since)
        order = kept.order = (
            since,
            blocks.filled(morton_order.order_of(crowd.x, crowd.y, crowd.group, area)),
        )
    longest = [frames * trajectory.seconds_per_frame for frames in (-SHUTTER, every + SHUTTER)]
    wraps = velocity.between(longest) if trajectory.wraps else None
    span = trajectory.heights.span if trajectory.heights is not None else (-np.inf, np.inf)
    return blocks.blocks_of(
        trajectory.kept_at(frame),
        order[1],
        trajectory.spheres,
        area,
        wraps,
        span if velocity.climbs else None,
    )


def _velocity(trajectory: Trajectory, since: int) -> VelocityBounds | None:
    """Return bounds of the velocity while blocks made at frame `since` may be asked for.

    None if not known.
    """
    return trajectory.velocity(since - SHUTTER, since + trajectory.every + SHUTTER)


def moved(trajectory: Trajectory, time: float, since: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (least, most) displacement, (3,) meters, of agents since their blocks.

    time: now; since: when the blocks were made; both in frames. Infinite where the blocks do not
        hold.
    """
    frames = max(time, trajectory.first_frame) - since
    velocity = _velocity(trajectory, since)
    beyond = (
        STILL not in trajectory.left_out and not -SHUTTER <= frames <= trajectory.every + SHUTTER
    )
    if beyond or velocity is None:
        return np.full(3, -np.inf), np.full(3, np.inf)
    return velocity.between([frames * trajectory.seconds_per_frame])


def approach(trajectory: Trajectory, time: float) -> Iterator[float]:
    """Compute the crowd and its blocks at `time`, in frames, so that they are cached.

    Yields the progress, 0 to 1, where that takes long. It may be closed at any time.
    """
    return trajectory.approach(time, partial(blocks_at, trajectory, time))
