"""The input of a frame's plan, and the times at which it looks for agents."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..culling.camera import Camera
from ..levels.assignment import Bias, LevelPolicy
from ..sources.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class Request:
    """The input of one frame's plan, besides the crowd.

    time: in frames; LODs are those of this time.
    eyes: one camera, or the eyes of a stereo picture.
    policy: how LODs follow from distance.
    shutter: with motion blur, (time in frames, the eyes' cameras from shutter.open_shutter) at each
        sample of the open shutter, in order. An agent seen at any of them is visible. With a fixed
        margin nothing is grown for the shutter except by the cameras' motion.
    bias: the painted detail map.
    """

    time: float
    eyes: tuple[Camera, ...]
    policy: LevelPolicy
    shutter: tuple[tuple[float, Sequence[Camera]], ...] = ()
    bias: Bias | None = None


@dataclass(frozen=True)
class Moment:
    """A time at which agents may be seen.

    time: in frames.
    eyes: the cameras at that time.
    radius: (G,) float64 meters, of the groups' spheres, which hold what is drawn until the next
        moment.
    """

    time: float
    eyes: Sequence[Camera]
    radius: np.ndarray


def moments(trajectory: Trajectory, request: Request) -> list[Moment]:
    """Return the times at which agents may be seen; LODs are those of the first."""
    reach = trajectory.spheres.reach
    grown = reach + trajectory.most_moved([time for time, _ in request.shutter])
    return [
        Moment(request.time, request.eyes, reach),
        *(Moment(time, eyes, grown) for time, eyes in request.shutter),
    ]
