"""Trajectories that change another one's: overridden agents, and what agents wear."""

from abc import abstractmethod
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.bounds import VelocityBounds
from ..crowd.wardrobe import draw_parts, slots_of
from ..world.maps import Area
from .trajectory import States, Trajectory


class ReusedColumns:
    """The latest columns of a crowd by name, each with the arrays that it was made of.

    A column is the same array while those arrays are the same: who looks at a crowd then sees at
    once that nothing has changed.
    """

    def __init__(self) -> None:
        self._columns: dict[str, tuple[Sequence[Any], np.ndarray]] = {}

    def of(self, name: str, parts: Sequence[Any], make: Callable[..., np.ndarray]) -> np.ndarray:
        """Return what `make` makes of the `parts`."""
        latest = self._columns.get(name)
        if latest is not None and all(a is b for a, b in zip(latest[0], parts, strict=True)):
            return latest[1]
        column = make(*parts)
        self._columns[name] = parts, column
        return column


class Changed(Trajectory):
    """The agents of another trajectory, with other columns. All else is as there.

    base: the other one. Agents that a column moves may stand beside its area.
    """

    def __init__(self, base: Trajectory):
        self.base = base
        self.groups = base.groups
        self.gaits = base.gaits
        self.heights = base.heights
        self.ids = base.ids
        self.given_phases = base.given_phases
        self.seconds_per_frame = base.seconds_per_frame
        self.every = base.every
        self.first_frame = base.first_frame
        self.still = base.still
        self.stays = base.stays
        self.reused = ReusedColumns()
        self.start = self._change(base.start)

    @abstractmethod
    def columns(self, crowd: Crowd) -> dict[str, np.ndarray]:
        """Return the columns that differ from those of `crowd`, of the other trajectory."""

    def _change(self, crowd: Crowd) -> Crowd:
        columns = self.columns(crowd)
        return replace(crowd, **columns) if columns else crowd

    @property
    def area(self) -> Area:
        return self.base.area

    @property
    def states(self) -> States:
        return self.base.states

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        return self.base.parts

    @property
    def level(self) -> bool:
        return self.base.level

    @property
    def wraps(self) -> bool:
        return self.base.wraps

    def at(self, time: float) -> Crowd:
        return self._change(self.base.at(time))

    def kept_at(self, frame: int) -> Crowd:
        return self._change(self.base.kept_at(frame))

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        yield from self.base.approach(time, then)

    def most_moved(self, times: Sequence[float]) -> float:
        return self.base.most_moved(times)

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        return self.base.velocity(since, until)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        return self.base.jumped(now, before, agents)

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return self.base.tilt(crowd, agents)

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        return self.base.ground(crowd, agents)


@dataclass(frozen=True)
class CrowdOverride:
    """An override of some agents, in all frames.

    agents: (m,) intp, their indices, each once.
    move: (x, y, z) meters that they stand beside their own way. On a ground that is not level they
        stand on it where they are, `z` meters above.
    group: the index of the group that they show; None for their own.
    hide: whether they are not there.
    """

    agents: np.ndarray
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    group: int | None = None
    hide: bool = False


class Overridden(Changed):
    """The agents of a trajectory, some of them overridden.

    Moves of one agent add up; of two groups the later holds; who is hidden once is hidden. All else
    is as without: agents keep their numbers, and walk, wait and choose as before.

    base: the trajectory without overrides.
    CrowdError if an override asks for another group, and the trajectory cannot give it.
    """

    def __init__(self, base: Trajectory, overrides: Sequence[CrowdOverride]):
        self.overrides = tuple(overrides)
        group = base.start.group.copy()
        hidden = np.zeros(len(group), bool)
        for override in overrides:
            hidden[override.agents] |= override.hide
            if override.group is not None:
                group[override.agents] = override.group
        if not np.array_equal(group, base.start.group):
            base = base.regrouped(group)
        self._visible = ~hidden if hidden.any() else None
        self._moved, self._move = _sum_moves(overrides)
        is_aside = self._move[:, :2].any(axis=1)
        self._aside = self._moved[is_aside]
        self._above_ground = self._move[is_aside, 2]
        super().__init__(base)
        # Blocks hold for agents that leave the area only if these are put back onto it.
        moves_off = base.wraps or not _all_on(base.start, self._moved, base.area)
        self._leaves_area = bool(len(self._moved)) and moves_off

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return the trajectory's bounds.

        None if they are not known, or if agents who are moved may be taken from one side of the
        area to another.
        """
        return None if self._leaves_area else self.base.velocity(since, until)

    def regrouped(self, group: np.ndarray) -> "Overridden":
        """Return the same crowd, overridden but for groups, with these."""
        return Overridden(
            self.base.regrouped(group),
            [replace(override, group=None) for override in self.overrides],
        )

    def digests(self) -> dict[str, bytes]:
        """Return the trajectory's, and the overrides."""
        overrides = [
            repr((override.move, override.group, override.hide)).encode()
            + override.agents.tobytes()
            for override in self.overrides
        ]
        return self.base.digests() | {"the overrides": b"\0".join(overrides)}

    def columns(self, crowd: Crowd) -> dict[str, np.ndarray]:
        """Return where those who are moved stand, and who is there."""
        columns = {}
        if len(self._moved):
            columns["x"] = self.reused.of("x", [crowd.x], lambda x: self._shift(x, 0))
            columns["y"] = self.reused.of("y", [crowd.y], lambda y: self._shift(y, 1))
            aside = replace(crowd, **columns)
            parts = [crowd.x, crowd.y, crowd.z]
            columns["z"] = self.reused.of("z", parts, lambda *_: self._raise(aside))
        visible = self._visible
        if visible is not None:
            columns["present"] = self.reused.of(
                "present",
                [crowd.present],
                lambda present: visible if present is None else present & visible,
            )
        return columns

    def _shift(self, column: np.ndarray, axis: int) -> np.ndarray:
        column = column.copy()
        column[self._moved] += self._move[:, axis]
        return column

    def _raise(self, crowd: Crowd) -> np.ndarray:
        """Return the heights of a crowd that is moved aside already."""
        z = self._shift(crowd.z, 2)
        ground = self.base.ground(crowd, self._aside) if len(self._aside) else None
        if ground is not None:
            z[self._aside] = ground + self._above_ground
        return z


def _sum_moves(overrides: Sequence[CrowdOverride]) -> tuple[np.ndarray, np.ndarray]:
    """Return (the agents (k,) intp that are moved, increasing, their moves (k, 3) meters)."""
    moving = [override for override in overrides if any(override.move)]
    if not moving:
        return np.empty(0, np.intp), np.empty((0, 3))
    agents = np.unique(np.concatenate([override.agents for override in moving]))
    moves = np.zeros((len(agents), 3))
    for override in moving:
        moves[np.searchsorted(agents, override.agents)] += override.move
    return agents, moves


def _all_on(crowd: Crowd, agents: np.ndarray, area: Area) -> bool:
    """Return whether all `agents` stand on the area."""
    x = crowd.x[agents]
    y = crowd.y[agents]
    on_x = (x >= area.x_min) & (x <= area.x_max)
    on_y = (y >= area.y_min) & (y <= area.y_max)
    return bool((on_x & on_y).all())


class Dressed(Changed):
    """The agents of a trajectory, and behind them the parts of their wardrobes that they wear.

    Agents keep their numbers. A part stands, turns and plays as its wearer does, and is of the
    group that is its part of the wardrobe.

    base: the agents without what they wear.
    """

    def __init__(self, base: Trajectory):
        count = len(base.start)
        wearer, part = draw_parts(base.groups, base.start.group, base.start.key)
        self._count = count
        self.wearer: np.ndarray = np.concatenate([np.arange(count), wearer])
        self._group = np.concatenate([base.start.group, part])
        super().__init__(base)
        self.gaits = self._gaits()
        if base.ids is not None:
            self.ids = np.concatenate([base.ids, np.full(len(wearer), -1)])
        if base.given_phases is not None:
            self.given_phases = base.given_phases[self.wearer]

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

    def columns(self, crowd: Crowd) -> dict[str, np.ndarray]:
        """Return all columns: those of the wearers, and behind them their parts'."""
        columns = {name: self._dress(name, column) for name, column in crowd.columns.items()}
        return columns | {"group": self._group}

    def _dress(self, name: str, wearers: np.ndarray) -> np.ndarray:
        return self.reused.of(name, [wearers], lambda column: column[self.wearer])
