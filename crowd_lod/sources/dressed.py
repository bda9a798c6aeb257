"""A crowd with what its agents wear: each worn part is an agent where its wearer is."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.bounds import VelocityBounds
from ..crowd.wardrobe import draw_parts, slots_of
from .around import AroundTrajectory
from .reused_columns import ReusedColumns
from .trajectory import Trajectory


class Dressed(AroundTrajectory):
    """The agents of a trajectory, and behind them the parts of their wardrobes that they wear.

    Agents keep their numbers. A part stands, turns and plays as its wearer does, and is of the
    group that is its part of the wardrobe.

    base: the agents without what they wear.
    """

    def __init__(self, base: Trajectory):
        self.base = base
        count = len(base.start)
        wearer, part = draw_parts(base.groups, base.start.group, base.start.key)
        self._count = count
        self.wearer: np.ndarray = np.concatenate([np.arange(count), wearer])
        self._group = np.concatenate([base.start.group, part])
        self.groups = base.groups
        self.gaits = self._gaits()
        self.heights = base.heights
        self.seconds_per_frame = base.seconds_per_frame
        self.every = base.every
        self.first_frame = base.first_frame
        if base.ids is not None:
            self.ids = np.concatenate([base.ids, np.full(len(wearer), -1)])
        if base.given_phases is not None:
            self.given_phases = base.given_phases[self.wearer]
        self._columns = ReusedColumns()
        self.start = self._of(base.start)
        self.still = base.still

    @property
    def bare(self) -> Trajectory:
        """The agents without what they wear."""
        return self.base

    @property
    def note(self) -> str:
        return self.base.note

    @cached_property
    def looks(self) -> np.ndarray:
        """Return a random number for each agent and for each part, (n,) float32 in [0, 1)."""
        numbers = self.base.looks[self.wearer]
        for g in np.unique(self._group[self._count :]).tolist():
            rows = self._count + np.flatnonzero(self._group[self._count :] == g)
            stream = random_streams.named(f"looks of {self.groups[g].slot}")
            numbers[rows] = random_streams.uniform(self.start.key[rows], stream)
        return numbers

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return the wearers' bounds."""
        return self.base.velocity(since, until)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` came back at the other side of the area."""
        return self.base.jumped(self._bare(now), self._bare(before), self.wearer[agents])

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of the wearers of `agents`."""
        return self.base.tilt(self._bare(crowd), self.wearer[agents])

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the height of the ground under the wearers of `agents`."""
        return self.base.ground(self._bare(crowd), self.wearer[agents])

    def digests(self) -> dict[str, bytes]:
        """Return the wearers', and what they wear."""
        return self.base.digests() | {"the wardrobe": self.wearer.tobytes() + self._group.tobytes()}

    def _gaits(self) -> Gaits:
        """Return the gaits in which a part plays as its wearers' group does."""
        gaits = self.base.gaits
        rates = gaits.rates.copy()
        played = np.ones(rates.shape, bool) if gaits.played is None else gaits.played.copy()
        for slot in slots_of(self.groups):
            rates[list(slot.parts)] = gaits.rates[slot.wearer]
            played[list(slot.parts)] = played[slot.wearer]
        return replace(gaits, rates=rates, played=None if gaits.played is None else played)

    def _bare(self, crowd: Crowd) -> Crowd:
        return crowd.of(slice(self._count))

    def _of(self, crowd: Crowd) -> Crowd:
        """Return `crowd`, of the wearers alone, with what they wear."""
        columns = {name: self._column(name, column) for name, column in crowd.columns.items()}
        return Crowd(**(columns | {"group": self._group}))

    def _column(self, name: str, wearers: np.ndarray) -> np.ndarray:
        return self._columns.of(name, [wearers], lambda column: column[self.wearer])
