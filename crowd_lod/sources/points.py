"""The crowd as another program places it, known at one time alone."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd import random_streams
from ..crowd.agents import CLASSES, Crowd, Group
from ..crowd.leave_outs import ALL, LeftOut, needless_of_places
from ..crowd.maps import Area
from ..crowd.paces import Paces
from ..crowd.variants import Draw
from ..crowd.velocity_bounds import VelocityBounds
from ..errors import CrowdError
from .trajectory import States, Trajectory

STATES = States(("there",), np.array([[90, 160, 220]], np.uint8))
SAME_TIME = 1e-4  # frames: Blender's sub-frames are float32


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Points at one time, one array per column.

    x, y, z: (n,) float64 world meters, the feet.
    heading: (n,) float32 radians; None if not known.
    phase: (n,) float32 in [0, 1), the places in their action's cycle; None if not known.
    group: (n,) uint8, indices of character groups; None if not known.
    ids: (n,) int64 from 0 on, different ones; None if points go by their order.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    heading: np.ndarray | None = None
    phase: np.ndarray | None = None
    group: np.ndarray | None = None
    ids: np.ndarray | None = None

    def same(self, other: "Snapshot") -> bool:
        """Return whether both hold the same."""
        return all(
            _same(getattr(self, each.name), getattr(other, each.name)) for each in fields(self)
        )


@dataclass(frozen=True, eq=False)
class Drawn:
    """What is drawn at random for agents, by their ids alone.

    ids: those of the snapshot.
    draw: what groups were drawn from, all as likely, and variants.
    key, group, phase_class: columns of the Crowd.
    """

    ids: np.ndarray | None
    seed: int
    draw: Draw
    key: np.ndarray
    group: np.ndarray
    phase_class: np.ndarray

    def holds(self, found: Snapshot, seed: int, draw: Draw) -> bool:
        """Return whether it holds for the agents `found`."""
        alike = len(self.key) == len(found.x) and _same(self.ids, found.ids)
        return alike and (self.seed, self.draw) == (seed, draw)


def drawn_for(found: Snapshot, seed: int, draw: Draw) -> Drawn:
    """Draw for the agents `found` from the groups of `draw`, all as likely, and their variants."""
    key = _keys(found, seed)
    which = (random_streams.uniform(key, random_streams.THEN) * len(draw)).astype(np.intp)
    classes = _classes(random_streams.uniform(key, random_streams.STATE))
    return Drawn(found.ids, seed, draw, key, draw.draw_variants(draw.groups[which], key), classes)


def dressed(found: Snapshot, seed: int, draw: Draw) -> Snapshot:
    """Return the agents `found` with the variants of their groups, where these are known and have
    some.
    """
    if found.group is None or all(len(own) == 1 for own in draw.variants):
        return found
    return replace(found, group=draw.draw_variants(found.group, _keys(found, seed)))


def _keys(found: Snapshot, seed: int) -> np.ndarray:
    return (
        random_streams.keys(seed, len(found.x))
        if found.ids is None
        else random_streams.keys_of(seed, found.ids)
    )


class Points(Trajectory):
    """Agents that stand where an object's points are now; where they are at any other time is not
    known.

    Agents whose group is not known get one at random, of those chosen. If the phase is not known
    they play by time, however they move; if the heading is not, they face +x. Velocities are not
    known, so there are no blocks: every agent is tested.

    found: the points.
    drawn: see `drawn_for`.
    time: in frames, when the points were found.
    groups, seconds: the character groups, and seconds per frame.
    name: the object's, for messages.
    """

    heights = None
    every = 16

    def __init__(
        self,
        found: Snapshot,
        drawn: Drawn,
        time: float,
        groups: Sequence[Group],
        seconds: float,
        name: str,
    ):
        self.found, self.drawn, self.time, self.name = found, drawn, time, name
        self.groups, self.seconds_per_frame, self.first_frame, self.ids = (
            tuple(groups),
            seconds,
            int(time),
            found.ids,
        )
        phased = found.phase is not None
        self.given_phases = np.ones(len(found.x), bool) if phased else None
        per_second = [
            1 / group.period if group.period > 0 and not phased else 0.0 for group in groups
        ]
        self.gaits = Gaits(
            CLASSES, Paces(np.zeros(1), np.zeros((1, 1), np.uint8)), np.array(per_second)[:, None]
        )
        self.start = Crowd(
            found.x,
            found.y,
            found.z,
            heading=np.zeros(len(found.x), np.float32) if found.heading is None else found.heading,
            state=np.zeros(len(found.x), np.uint8),
            group=drawn.group if found.group is None else found.group,
            phase_class=drawn.phase_class if found.phase is None else _classes(found.phase),
            key=drawn.key,
        )
        self.leave: frozenset[LeftOut] = ALL
        self.left_out = needless_of_places(self.start, relief=True)

    @property
    def area(self) -> Area:
        """The rectangle about the agents, and the largest sphere's radius more."""
        x, y, z = self.found.x, self.found.y, self.found.z
        around = max(group.radius for group in self.groups) or 1.0
        edges = (
            float(x.min()) - around,
            float(y.min()) - around,
            float(x.max()) + around,
            float(y.max()) + around,
        )
        return Area(*edges, float(z.min()))

    @property
    def states(self) -> States:
        """One for all."""
        return STATES

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return None: not known."""
        return None

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames; CrowdError if it is not the time of the points."""
        if abs(time - self.time) > SAME_TIME:
            raise CrowdError(
                f"Where the points of {self.name} are at frame {time:g} is not known at frame "
                f"{self.time:g}: press Record Points, "
                "which writes down where they are in all frames of the shot."
            )
        return self.start

    def regrouped(self, group: np.ndarray) -> "Points":
        """Return the same crowd with its agents in the groups `group`."""
        found = replace(self.found, group=group)
        return Points(found, self.drawn, self.time, self.groups, self.seconds_per_frame, self.name)

    def leaving(self, leave: frozenset[LeftOut], time: float) -> "Points":
        """Return the same crowd with only `leave` left out."""
        other = Points(
            self.found, self.drawn, self.time, self.groups, self.seconds_per_frame, self.name
        )
        other.leave, other.left_out = leave, leave & self.left_out
        return other

    def digests(self) -> dict[str, bytes]:
        """Return which points they are, not where: they follow the object, and no shot plan is made
        for them.
        """
        return {
            "the points": repr(
                (self.name, self.drawn.seed, tuple(self.drawn.draw.groups.tolist()))
            ).encode()
        }


def _classes(phase: np.ndarray) -> np.ndarray:
    return (np.rint(phase * CLASSES) % CLASSES).astype(np.uint8)


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is other or (one is not None and other is not None and np.array_equal(one, other))
