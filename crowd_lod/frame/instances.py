"""A plan as instances: which agents a shot shows, as which prototype, and turned how.

A prototype is a character of a LOD: LOD x number of characters + the character's number in its
Library.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..animation.phase_classes import Library
from .frame import Frame


@dataclass(frozen=True)
class Shown:
    """Who a frame shows, and as what.

    agents: (m,) intp, increasing; with those that only cast a shadow or are only in mirrors.
    prototype: (m,) int64.
    off: the largest difference between the phase of an agent and that of its prototype, in cycles.
    """

    agents: np.ndarray
    prototype: np.ndarray
    off: float


def shown(frame: Frame, library: Library) -> Shown:
    """Return who `frame` shows, as characters of the `library`."""
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
    character = library.shown(gaits, frame.crowd, seconds, agents)
    count = library.posed[frame.crowd.group[agents]]
    beside = np.where(
        count > 1, gaits.phase(frame.crowd, seconds, agents) * np.float64(1) * count, 0.0
    )
    beside = np.abs(beside - np.rint(beside)) / np.maximum(count, 1)
    return Shown(
        agents, levels * int(library.first(gaits)[-1]) + character, float(beside.max(initial=0.0))
    )


@dataclass(frozen=True)
class Instances:
    """The agents and prototypes of a shot.

    agents: (a,) intp, increasing: those that any frame shows.
    prototypes: (p,) intp, increasing: those that any frame shows.
    """

    agents: np.ndarray
    prototypes: np.ndarray

    def at(self, frame: Shown) -> tuple[np.ndarray, np.ndarray]:
        """Return (which of `prototypes` each agent shows, (a,) int32; the agents that are not
        shown, int64).

        An agent that is not shown has the first prototype.
        """
        place = np.searchsorted(self.agents, frame.agents)
        which = np.zeros(len(self.agents), np.int32)
        there = np.zeros(len(self.agents), bool)
        which[place] = np.searchsorted(self.prototypes, frame.prototype)
        there[place] = True
        return which, self.agents[~there].astype(np.int64)


def instances_of(frames: Sequence[Shown]) -> Instances:
    """Return the agents and prototypes that any of `frames` shows."""
    return Instances(
        _any([frame.agents for frame in frames]), _any([frame.prototype for frame in frames])
    )


def _any(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return the numbers that any of `parts` has, increasing, intp."""
    found = np.zeros(1 + max(int(part.max(initial=-1)) for part in parts), bool)
    for part in parts:
        found[part] = True
    return np.flatnonzero(found)


def turned(heading: np.ndarray, pitch: np.ndarray, roll: np.ndarray, turn: float) -> np.ndarray:
    """Return the rotations Rz(heading) Ry(-pitch) Rx(roll) Rz(turn) as unit quaternions (m, 4)
    float64.

    Columns x, y, z, w. Angles (m,) in radians.
    """
    found = _about(2, heading)
    for axis, angle in ((1, -pitch), (0, roll), (2, np.full(len(heading), turn))):
        found = _product(found, _about(axis, angle))
    return found


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    found = np.zeros((len(angle), 4))
    half = np.asarray(angle, np.float64) / 2
    found[:, axis] = np.sin(half)
    found[:, 3] = np.cos(half)
    return found


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternions a b, (m, 4)."""
    v = a[:, :3]
    w = a[:, 3:]
    u = b[:, :3]
    s = b[:, 3:]
    return np.concatenate(
        [w * u + s * v + np.cross(v, u), w * s - (v * u).sum(axis=1, keepdims=True)], axis=1
    )
