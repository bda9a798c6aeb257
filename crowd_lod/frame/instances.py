"""A plan as instances: which agents a shot shows, as which prototypes, and their rotations.

A prototype is a character of a LOD: LOD x number of characters + the character's number in its
Cast.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..animation.phase_classes import Cast
from .frame import Frame


@dataclass(frozen=True)
class FrameInstances:
    """Who a frame shows, and as what.

    agents: (m,) intp, increasing; with those that only cast a shadow or are only in mirrors.
    prototype: (m,) int64.
    off: the largest difference between the phase of an agent and that of its prototype, in cycles.
    """

    agents: np.ndarray
    prototype: np.ndarray
    off: float


def instances_of_frame(frame: Frame, cast: Cast) -> FrameInstances:
    """Return who `frame` shows, as characters of the `cast`."""
    kinds = [
        buckets for buckets in (frame.buckets, frame.shadow, frame.mirrored) if buckets is not None
    ]
    agents = np.concatenate([buckets.order for buckets in kinds]).astype(np.intp)
    levels = np.concatenate(
        [np.repeat(np.arange(len(buckets.counts)), buckets.counts) for buckets in kinds]
    )
    order = np.argsort(agents, kind="stable")
    agents = agents[order]
    levels = levels[order]
    gaits = frame.trajectory.gaits
    seconds = frame.trajectory.seconds(frame.time)
    character = cast.character_of(gaits, frame.crowd, seconds, agents)
    count = cast.posed[frame.crowd.group[agents]]
    phase = gaits.phase(frame.crowd, seconds, agents).astype(np.float64)
    pose = np.where(count > 1, phase * count, 0.0)
    off = np.abs(pose - np.rint(pose)) / np.maximum(count, 1)
    return FrameInstances(
        agents=agents,
        prototype=levels * int(cast.first(gaits)[-1]) + character,
        off=float(off.max(initial=0.0)),
    )


@dataclass(frozen=True)
class Instances:
    """The agents and prototypes of a shot.

    agents: (a,) intp, increasing: those that any frame shows.
    prototypes: (p,) intp, increasing: those that any frame shows.
    """

    agents: np.ndarray
    prototypes: np.ndarray

    def at(self, frame: FrameInstances) -> tuple[np.ndarray, np.ndarray]:
        """Return (numbers, absent_agents) of a frame.

        numbers: (a,) int32, which of `prototypes` each agent shows; 0 for an absent one.
        absent_agents: (k,) int64, the agents that the frame does not show.
        """
        place = np.searchsorted(self.agents, frame.agents)
        numbers = np.zeros(len(self.agents), np.int32)
        is_present = np.zeros(len(self.agents), bool)
        numbers[place] = np.searchsorted(self.prototypes, frame.prototype)
        is_present[place] = True
        return numbers, self.agents[~is_present].astype(np.int64)


def instances_of(frames: Sequence[FrameInstances]) -> Instances:
    """Return the agents and prototypes that any of `frames` shows."""
    return Instances(
        _any([frame.agents for frame in frames]), _any([frame.prototype for frame in frames])
    )


def _any(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return the numbers that any of `parts` has, increasing, intp."""
    is_present = np.zeros(1 + max(int(part.max(initial=-1)) for part in parts), bool)
    for part in parts:
        is_present[part] = True
    return np.flatnonzero(is_present)


def rotations_of(
    heading: np.ndarray, pitch: np.ndarray, roll: np.ndarray, turn: float
) -> np.ndarray:
    """Return the rotations Rz(heading) Ry(-pitch) Rx(roll) Rz(turn) as unit quaternions.

    (m, 4) float64, columns x, y, z, w. Angles (m,) in radians.
    """
    rotation = _about(2, heading)
    for axis, angle in ((1, -pitch), (0, roll), (2, np.full(len(heading), turn))):
        rotation = _product(rotation, _about(axis, angle))
    return rotation


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    rotation = np.zeros((len(angle), 4))
    half = np.asarray(angle, np.float64) / 2
    rotation[:, axis] = np.sin(half)
    rotation[:, 3] = np.cos(half)
    return rotation


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternions a b, (m, 4)."""
    v, w = np.split(a, [3], axis=1)
    u, s = np.split(b, [3], axis=1)
    return np.concatenate(
        [w * u + s * v + np.cross(v, u), w * s - (v * u).sum(axis=1, keepdims=True)], axis=1
    )
