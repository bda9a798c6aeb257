"""Several crowds as one: their agents one after the other."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..animation.phase_classes import Gaits, gaits_of
from ..crowd.agents import Crowd, Group
from ..crowd.leave_outs import LeftOut, needless_of_places
from ..crowd.maps import Area
from ..crowd.paces import Paces
from ..crowd.velocity_bounds import STANDING, VelocityBounds
from ..errors import CrowdError
from ..progress import share
from .trajectory import States, Trajectory

MOST = 256  # states, and paces, of all crowds together: they are counted in a byte


class Several(Trajectory):
    """The agents of several trajectories, one after the other.

    The first trajectory's agents keep their numbers; each other's are moved up by those before.

    members: trajectories with the same groups, at least one. Of each group the largest radius
    holds.
    names: of the crowds, for their states.
    shown: which of them are there. Agents of others keep their numbers and are absent.
    """

    heights = None

    def __init__(self, members: Sequence[Trajectory], names: Sequence[str], shown: Sequence[bool]):
        self.members, self.names, self.shown = tuple(members), tuple(names), tuple(shown)
        first = members[0]
        radius = np.max(
            [[group.radius for group in each.groups] for each in members], axis=0
        ).tolist()
        self.groups: tuple[Group, ...] = tuple(map(_of_radius, first.groups, radius))
        self.seconds_per_frame, self.every, self.leave = (
            first.seconds_per_frame,
            first.every,
            first.leave,
        )
        self.first_frame = min(each.first_frame for each in members)
        counts = [len(each.start) for each in members]
        self._begins = np.append(0, np.cumsum(counts)).tolist()
        states, paces = ([len(own(each)) for each in members] for own in (_states, _speeds))
        for what, sizes in (("states", states), ("paces", paces)):
            if sum(sizes) > MOST:
                raise CrowdError(
                    f"The crowds have {sum(sizes)} {what} together: use at most {MOST}, or fewer "
                    f"crowds."
                )
        counts_of = (("state", states), ("pace", paces), ("played", paces))
        self._moved_up = {
            name: np.append(0, np.cumsum(sizes))[:-1].tolist() for name, sizes in counts_of
        }
        self.gaits = self._gaits()
        # of each column, what it was made of, and itself: most do not change from frame to frame
        self._joined: dict[str, tuple[list[Any], np.ndarray]] = {}
        self._absent = [np.zeros(count, bool) for count in counts]
        self._all_there = [np.ones(count, bool) for count in counts]
        self._unfaded = [np.ones(count, np.float32) for count in counts]
        self.start = self._together([each.start for each in members])
        if any(each.ids is not None for each in members):
            self.ids = np.concatenate(
                [np.full(len(each.start), -1) if each.ids is None else each.ids for each in members]
            )
        if any(each.given_phases is not None for each in members):
            self.given_phases = np.concatenate(
                [
                    np.zeros(len(each.start), bool)
                    if each.given_phases is None
                    else each.given_phases
                    for each in members
                ]
            )
        self.left_out = self.leave & self._needless()

    @property
    def area(self) -> Area:
        """The rectangle about those of all crowds."""
        areas = [each.area for each in self.members]
        x_min, y_min = (min(getattr(area, name) for area in areas) for name in ("x_min", "y_min"))
        x_max, y_max = (max(getattr(area, name) for area in areas) for name in ("x_max", "y_max"))
        return Area(x_min, y_min, x_max, y_max, areas[0].z)

    @property
    def states(self) -> States:
        """Those of the first crowd, then of each other with its name."""
        own = [_states(each) for each in self.members]
        named = [
            [f"{name}: {state}" for state in states]
            for name, states in zip(self.names[1:], own[1:], strict=True)
        ]
        colors = np.concatenate([each.states.colors for each in self.members])
        return States((*own[0], *(state for states in named for state in states)), colors)

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        """Those of all crowds."""
        return tuple(part for each in self.members for part in each.parts)

    @property
    def level(self) -> bool:
        """Whether nobody ever leaves its height."""
        return all(each.level for each in self.members)

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return bounds of all crowds' velocities.

        None if those of one are not known, or if one wraps around: its agents come back at the
        other side of its own area, not of this one's.
        """
        found = STANDING
        for each in self.members:
            own = each.velocity(since, until)
            if own is None or each.wraps:
                return None
            found = found.union(own)
        return found

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames. Crowds that are not shown stand as at their
        start.
        """
        return self._together(
            [
                each.at(time) if shown else each.start
                for each, shown in zip(self.members, self.shown, strict=True)
            ]
        )

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Do what `at` needs, crowd by crowd."""
        for k, each in enumerate(self.members):
            if self.shown[k]:
                yield from share(
                    each.approach(time), k / len(self.members), (k + 1) / len(self.members)
                )
        then()

    def most_moved(self, times: Sequence[float]) -> float:
        """Return the most of all crowds."""
        return max(each.most_moved(times) for each in self.members)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` came back at the other side of their own crowd's area."""
        return self._by_member(
            agents, lambda each, own, some: each.jumped(now.of(own), before.of(own), some), bool
        )

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents`, each on its own crowd's ground."""

        def of_member(each: Trajectory, own: slice, some: np.ndarray) -> np.ndarray | None:
            found = each.tilt(crowd.of(own), some)
            return None if found is None else np.stack(found, axis=1)

        found = self._by_member(agents, of_member, np.float32, 2)
        return None if found is None else (found[:, 0], found[:, 1])

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the heights of the ground under `agents`, each on its own crowd's.

        Its own height where it has none.
        """

        def of_member(each: Trajectory, own: slice, some: np.ndarray) -> np.ndarray:
            found = each.ground(crowd.of(own), some)
            return crowd.z[own][some] if found is None else found

        return self._by_member(agents, of_member, float)

    def regrouped(self, group: np.ndarray) -> "Several":
        """Return the same crowds, each with its agents in other groups."""
        parts = np.split(group, self._begins[1:-1])
        return Several(
            [each.regrouped(own) for each, own in zip(self.members, parts, strict=True)],
            self.names,
            self.shown,
        )

    def leaving(self, leave: frozenset[LeftOut], time: float) -> "Several":
        """Return the same crowds with only `leave` left out."""
        several = Several(
            [each.leaving(leave, time) for each in self.members], self.names, self.shown
        )
        several.left_out = leave & self.left_out
        return several

    def digests(self) -> dict[str, bytes]:
        """Return those of the first crowd, and all of the others' together."""
        others = [
            f"{name} {shown}".encode() for name, shown in zip(self.names, self.shown, strict=True)
        ]
        others += [data for each in self.members[1:] for data in each.digests().values()]
        return self.members[0].digests() | {"a further crowd": b"\0".join(others)}

    def _gaits(self) -> Gaits:
        own = [each.gaits for each in self.members]
        speeds = np.concatenate([each.paces.speeds for each in own])
        actions = [each.paces.actions or ("",) * len(each.paces.speeds) for each in own]
        names = tuple(name for each in actions for name in each)
        off = max(each.paces.off for each in own)
        paces = Paces(speeds, np.zeros((0, 0), np.uint8), off, names if any(names) else ())
        played = np.zeros((len(self.groups), len(speeds)), bool)
        for each, pace in zip(self.members, self._moved_up["pace"], strict=True):
            playing = np.ix_(np.unique(each.start.group), range(pace, pace + len(_speeds(each))))
            played[playing] = True
        gaits = gaits_of(self.groups, paces, own[0].classes, np.empty(0, np.intp))
        return Gaits(gaits.classes, paces, gaits.rates, played)

    def _needless(self) -> frozenset[LeftOut]:
        alike = frozenset.intersection(*(each.left_out for each in self.members))
        places = needless_of_places(self.start, not self.level)
        return places | {item for item in alike if item.stage == "behavior"}

    def _together(self, crowds: list[Crowd]) -> Crowd:
        if any(
            crowd.played is not None for crowd in crowds
        ):  # who never cross-fades shows its pace
            crowds = [
                replace(crowd, played=crowd.pace, faded=unfaded) if crowd.played is None else crowd
                for crowd, unfaded in zip(crowds, self._unfaded, strict=True)
            ]
        names = crowds[0].columns.keys() - {"present"}
        columns = {
            name: self._column(name, [getattr(crowd, name) for crowd in crowds]) for name in names
        }
        if all(self.shown) and all(crowd.present is None for crowd in crowds):
            return Crowd(**columns)
        there = [
            self._absent[k]
            if not self.shown[k]
            else self._all_there[k]
            if crowd.present is None
            else crowd.present
            for k, crowd in enumerate(crowds)
        ]
        return Crowd(**columns, present=self._column("present", there))

    def _column(self, name: str, parts: list[np.ndarray]) -> np.ndarray:
        known = self._joined.get(name)
        if known is not None and all(a is b for a, b in zip(known[0], parts, strict=True)):
            return known[1]
        moved = zip(parts, self._moved_up.get(name, [0] * len(parts)), strict=True)
        column = np.concatenate([part + part.dtype.type(up) if up else part for part, up in moved])
        self._joined[name] = parts, column
        return column

    def _by_member(
        self, agents: np.ndarray, ask: Callable, kind: type, width: int = 0
    ) -> np.ndarray | None:
        """Return what `ask` (member, its slice of all agents, its own agents) finds, for each of
        `agents`.

        0 for members where it finds None; None if all do.
        """
        which = np.searchsorted(self._begins, agents, side="right") - 1
        found: np.ndarray = np.zeros((len(agents), width) if width else len(agents), kind)
        any_found = False
        for k, each in enumerate(self.members):
            own = np.flatnonzero(which == k)
            told = (
                ask(each, slice(*self._begins[k : k + 2]), agents[own] - self._begins[k])
                if len(own)
                else None
            )
            if told is not None:
                found[own], any_found = told, True
        return found if any_found else None


def _of_radius(group: Group, radius: float) -> Group:
    return replace(group, radius=radius)


def _states(trajectory: Trajectory) -> tuple[str, ...]:
    return trajectory.states.names


def _speeds(trajectory: Trajectory) -> np.ndarray:
    return trajectory.gaits.paces.speeds
