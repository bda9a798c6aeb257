"""A crowd with some of its agents overridden."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.bounds import VelocityBounds
from ..world.maps import Area
from .around import AroundTrajectory
from .reused_columns import ReusedColumns
from .trajectory import Trajectory


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


class Overridden(AroundTrajectory):
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
        self.base = base
        self._visible = ~hidden if hidden.any() else None
        self._moved, self._move = _sum_moves(overrides)
        is_aside = self._move[:, :2].any(axis=1)
        self._aside = self._moved[is_aside]
        self._above_ground = self._move[is_aside, 2]
        self.groups = base.groups
        self.gaits = base.gaits
        self.heights = base.heights
        self.ids = base.ids
        self.given_phases = base.given_phases
        self.seconds_per_frame = base.seconds_per_frame
        self.every = base.every
        self.first_frame = base.first_frame
        self._columns = ReusedColumns()
        self.start = self._of(base.start)
        self.still = base.still
        # Blocks hold for agents that leave the area only if these are put back onto it.
        moves_off = base.wraps or not _all_on(base.start, self._moved, base.area)
        self._leaves_area = bool(len(self._moved)) and moves_off

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return the trajectory's bounds.

        None if they are not known, or if agents who are moved may be taken from one side of the
        area to another.
        """
        return None if self._leaves_area else self.base.velocity(since, until)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` came back at the other side of the area."""
        return self.base.jumped(now, before, agents)

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents` where they stand now."""
        return self.base.tilt(crowd, agents)

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the height of the ground under `agents`."""
        return self.base.ground(crowd, agents)

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

    def _of(self, crowd: Crowd) -> Crowd:
        """Return `crowd`, of the trajectory without overrides, with them."""
        columns = {}
        if len(self._moved):
            columns["x"] = self._columns.of("x", [crowd.x], lambda x: self._shift(x, 0))
            columns["y"] = self._columns.of("y", [crowd.y], lambda y: self._shift(y, 1))
            aside = replace(crowd, **columns)
            parts = [crowd.x, crowd.y, crowd.z]
            columns["z"] = self._columns.of("z", parts, lambda *_: self._raise(aside))
        visible = self._visible
        if visible is not None:
            columns["present"] = self._columns.of(
                "present",
                [crowd.present],
                lambda present: visible if present is None else present & visible,
            )
        return replace(crowd, **columns) if columns else crowd

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
