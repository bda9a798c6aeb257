"""The crowd as another program places it, known at one time alone."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd import random_streams
from ..crowd.agents import CLASSES, Crowd, Draw, Group
from ..crowd.bounds import VelocityBounds
from ..crowd.paces import Paces
from ..errors import CrowdError
from ..world.maps import Area
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
            _same(getattr(self, column.name), getattr(other, column.name))
            for column in fields(self)
        )


@dataclass(frozen=True, eq=False)
class Drawn:
    """What is drawn at random for agents, by their ids alone.

    ids: those of the snapshot.
    draw: what groups were drawn from, all as likely.
    key, group, phase_class: columns of the Crowd.
    """

    ids: np.ndarray | None
    seed: int
    draw: Draw
    key: np.ndarray
    group: np.ndarray
    phase_class: np.ndarray

    def holds(self, points: Snapshot, seed: int, draw: Draw) -> bool:
        """Return whether it holds for the agents of `points`."""
        alike = len(self.key) == len(points.x) and _same(self.ids, points.ids)
        return alike and (self.seed, self.draw) == (seed, draw)


def draw_for(points: Snapshot, seed: int, draw: Draw) -> Drawn:
    """Draw for the agents of `points` from the groups of `draw`, all as likely."""
    key = _keys(points, seed)
    choice = (random_streams.uniform(key, random_streams.THEN) * len(draw)).astype(np.intp)
    group = draw.groups[choice]
    classes = _classes(random_streams.uniform(key, random_streams.STATE))
    return Drawn(points.ids, seed, draw, key, group, classes)


def _keys(points: Snapshot, seed: int) -> np.ndarray:
    if points.ids is None:
        return random_streams.keys(seed, len(points.x))
    return random_streams.keys_of(seed, points.ids)


class Points(Trajectory):
    """Agents that stand where an object's points are now, and at no other time.

    Agents whose group is not known get one at random, of those chosen. If the phase is not known
    they play by time, however they move; if the heading is not, they face +x. Velocities are not
    known, so there are no blocks: every agent is tested.

    points: where they are.
    drawn: see `draw_for`.
    time: in frames, at which the points are there.
    groups, seconds: the character groups, and seconds per frame.
    name: the object's, for messages.
    """

    heights = None
    every = 16

    def __init__(
        self,
        points: Snapshot,
        draws: Drawn,
        time: float,
        groups: Sequence[Group],
        seconds: float,
        name: str,
    ):
        self.points = points
        self.drawn = draws
        self.time = time
        self.name = name
        self.groups = tuple(groups)
        self.seconds_per_frame = seconds
        self.first_frame = int(time)
        self.ids = points.ids
        count = len(points.x)
        has_phases = points.phase is not None
        self.given_phases = np.ones(count, bool) if has_phases else None
        rates = [
            1 / group.period if group.period > 0 and not has_phases else 0.0 for group in groups
        ]
        one_pace = Paces(np.zeros(1), np.zeros((1, 1), np.uint8))
        self.gaits = Gaits(CLASSES, one_pace, np.array(rates)[:, None])
        self.start = Crowd(
            points.x,
            points.y,
            points.z,
            heading=np.zeros(count, np.float32) if points.heading is None else points.heading,
            state=np.zeros(count, np.uint8),
            group=draws.group if points.group is None else points.group,
            phase_class=draws.phase_class if points.phase is None else _classes(points.phase),
            key=draws.key,
        )

    @property
    def area(self) -> Area:
        """The rectangle about the agents, and the largest sphere's radius more."""
        points = self.points
        around = max(group.radius for group in self.groups) or 1.0
        return Area(
            float(points.x.min()) - around,
            float(points.y.min()) - around,
            float(points.x.max()) + around,
            float(points.y.max()) + around,
            float(points.z.min()),
        )

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
                f"The points of {self.name} at frame {time:g} are not known at frame "
                f"{self.time:g}: press Record Points, which writes those of all frames of the shot."
            )
        return self.start

    def regrouped(self, group: np.ndarray) -> "Points":
        """Return the same crowd with its agents in the groups `group`."""
        return self._with(replace(self.points, group=group))

    def _with(self, points: Snapshot) -> "Points":
        return Points(points, self.drawn, self.time, self.groups, self.seconds_per_frame, self.name)

    def digests(self) -> dict[str, bytes]:
        """Return which points they are, not where: no shot plan is made for them."""
        groups = tuple(self.drawn.draw.groups.tolist())
        return {"the points": repr((self.name, self.drawn.seed, groups)).encode()}


def _classes(phase: np.ndarray) -> np.ndarray:
    return (np.rint(phase * CLASSES) % CLASSES).astype(np.uint8)


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is other or (one is not None and other is not None and np.array_equal(one, other))
