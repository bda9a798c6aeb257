"""Several crowds as one: their agents one after the other."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace

import numpy as np

from ..animation.phase_classes import Gaits, gaits_of
from ..crowd.agents import Crowd, Group
from ..crowd.bounds import STANDING, VelocityBounds
from ..crowd.paces import Paces
from ..errors import CrowdError
from ..progress import Workload
from ..world.maps import Area
from .changed import ReusedColumns
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

    def __init__(
        self, members: Sequence[Trajectory], names: Sequence[str], is_shown: Sequence[bool]
    ):
        self.members = tuple(members)
        self.names = tuple(names)
        self.shown = tuple(is_shown)
        first = members[0]
        self.groups: tuple[Group, ...] = tuple(
            map(_largest, *(member.groups for member in members))
        )
        self.seconds_per_frame = first.seconds_per_frame
        self.every = first.every
        self.first_frame = min(member.first_frame for member in members)
        counts = [len(member.start) for member in members]
        self._begins = np.append(0, np.cumsum(counts)).tolist()
        self._offsets = self._number_offsets()
        self.gaits = self._gaits()
        self._columns = ReusedColumns()
        self._absent = [np.zeros(count, bool) for count in counts]
        self._all_there = [np.ones(count, bool) for count in counts]
        self._unfaded = [np.ones(count, np.float32) for count in counts]
        self.start = self._together([member.start for member in members])
        if any(member.ids is not None for member in members):
            self.ids = np.concatenate(
                [
                    np.full(count, -1) if member.ids is None else member.ids
                    for member, count in zip(members, counts, strict=True)
                ]
            )
        if any(member.given_phases is not None for member in members):
            self.given_phases = np.concatenate(
                [
                    absent if member.given_phases is None else member.given_phases
                    for member, absent in zip(members, self._absent, strict=True)
                ]
            )
        self.still = all(member.still for member in self.members)
        self.stays = all(member.stays for member in self.members)

    def _number_offsets(self) -> dict[str, list[int]]:
        """Return for each column that holds numbers by how much those of each member move up.

        CrowdError if there are more numbers than a byte counts.
        """
        states = [len(_states(member)) for member in self.members]
        paces = [len(_speeds(member)) for member in self.members]
        for kind, sizes in (("states", states), ("paces", paces)):
            if sum(sizes) > MOST:
                raise CrowdError(
                    f"The crowds have {sum(sizes)} {kind} together: use at most {MOST}, or fewer "
                    f"crowds."
                )
        sizes_of = {"state": states, "pace": paces, "played": paces}
        return {
            name: np.append(0, np.cumsum(sizes))[:-1].tolist() for name, sizes in sizes_of.items()
        }

    @property
    def area(self) -> Area:
        """The rectangle about those of all crowds."""
        areas = [member.area for member in self.members]
        return Area(
            min(area.x_min for area in areas),
            min(area.y_min for area in areas),
            max(area.x_max for area in areas),
            max(area.y_max for area in areas),
            areas[0].z,
        )

    @property
    def states(self) -> States:
        """Those of the first crowd, then of each other with its name."""
        first, *others = self.members
        states = list(_states(first))
        for name, member in zip(self.names[1:], others, strict=True):
            states += [f"{name}: {state}" for state in _states(member)]
        colors = np.concatenate([member.states.colors for member in self.members])
        return States(tuple(states), colors)

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        """Those of all crowds."""
        return tuple(part for member in self.members for part in member.parts)

    @property
    def level(self) -> bool:
        """Whether nobody ever leaves its height."""
        return all(member.level for member in self.members)

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return bounds of all crowds' velocities.

        None if those of one are not known, or if one wraps around: its agents come back at the
        other side of its own area, not of this one's.
        """
        bounds = STANDING
        for member in self.members:
            velocity = member.velocity(since, until)
            if velocity is None or member.wraps:
                return None
            bounds = bounds.union(velocity)
        return bounds

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames.

        Crowds that are not shown stand as at their start.
        """
        crowds = [
            member.at(time) if shown else member.start
            for member, shown in zip(self.members, self.shown, strict=True)
        ]
        return self._together(crowds)

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Do what `at` needs, crowd by crowd."""
        work = Workload(sum(self.shown))
        for member, is_shown in zip(self.members, self.shown, strict=True):
            if is_shown:
                yield from work.take(member.approach(time), 1)
        then()

    def most_moved(self, times: Sequence[float]) -> float:
        """Return the most of all crowds."""
        return max(member.most_moved(times) for member in self.members)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` came back at the other side of their own crowd's area."""

        def ask(member: Trajectory, part: slice, own_agents: np.ndarray) -> np.ndarray | None:
            return member.jumped(now.of(part), before.of(part), own_agents)

        return self._by_member(agents, ask, bool)

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents`, each on its own crowd's ground."""

        def ask(member: Trajectory, part: slice, own_agents: np.ndarray) -> np.ndarray | None:
            tilt = member.tilt(crowd.of(part), own_agents)
            return None if tilt is None else np.stack(tilt, axis=1)

        tilts = self._by_member(agents, ask, np.float32, 2)
        return None if tilts is None else (tilts[:, 0], tilts[:, 1])

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the heights of the ground under `agents`, each on its own crowd's.

        Its own height where it has none.
        """

        def ask(member: Trajectory, part: slice, own_agents: np.ndarray) -> np.ndarray:
            heights = member.ground(crowd.of(part), own_agents)
            return crowd.z[part][own_agents] if heights is None else heights

        return self._by_member(agents, ask, float)

    def regrouped(self, group: np.ndarray) -> "Several":
        """Return the same crowds, each with its agents in other groups."""
        parts = np.split(group, self._begins[1:-1])
        members = [member.regrouped(part) for member, part in zip(self.members, parts, strict=True)]
        return Several(members, self.names, self.shown)

    def digests(self) -> dict[str, bytes]:
        """Return those of the first crowd, and all of the others' together.

        The first crowd's name is left out: states do not have it.
        """
        names = ("", *self.names[1:])
        parts = [f"{name} {shown}".encode() for name, shown in zip(names, self.shown, strict=True)]
        parts += [data for member in self.members[1:] for data in member.digests().values()]
        return self.members[0].digests() | {"the other crowds": b"\0".join(parts)}

    def _gaits(self) -> Gaits:
        """Return the gaits at the paces of all members, one after the other."""
        all_paces = [member.gaits.paces for member in self.members]
        names: list[str] = []
        for paces in all_paces:
            names += paces.actions or ("",) * len(paces.speeds)
        together = Paces(
            speeds=np.concatenate([paces.speeds for paces in all_paces]),
            of=np.zeros((0, 0), np.uint8),
            off=max(paces.off for paces in all_paces),
            actions=tuple(names) if any(names) else (),
        )
        played = np.zeros((len(self.groups), len(names)), bool)
        for member, first in zip(self.members, self._offsets["pace"], strict=True):
            own_paces = range(first, first + len(_speeds(member)))
            played[np.ix_(np.unique(member.start.group), own_paces)] = True
        classes = self.members[0].gaits.classes
        gaits = gaits_of(self.groups, together, classes, np.empty(0, np.intp))
        return Gaits(gaits.classes, together, gaits.rates, played)

    def _together(self, crowds: list[Crowd]) -> Crowd:
        if any(crowd.played is not None for crowd in crowds):
            # who never cross-fades shows its pace
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
        present = [self._present(k, crowd) for k, crowd in enumerate(crowds)]
        return Crowd(**columns, present=self._column("present", present))

    def _present(self, k: int, crowd: Crowd) -> np.ndarray:
        """Return which agents of the member number `k` are there, bool."""
        if not self.shown[k]:
            return self._absent[k]
        return self._all_there[k] if crowd.present is None else crowd.present

    def _column(self, name: str, parts: list[np.ndarray]) -> np.ndarray:
        """Return the members' columns as one."""
        offsets = self._offsets.get(name, [0] * len(parts))

        def join(*parts: np.ndarray) -> np.ndarray:
            return np.concatenate(
                [
                    part + part.dtype.type(offset) if offset else part
                    for part, offset in zip(parts, offsets, strict=True)
                ]
            )

        return self._columns.of(name, parts, join)

    def _by_member(
        self, agents: np.ndarray, ask: Callable, dtype: type, width: int = 0
    ) -> np.ndarray | None:
        """Return what each member answers for its part of `agents` (m,), (m,) or (m, width).

        0 for members that answer None; None if all do.

        ask: takes a member, its slice of all agents, and its agents, counted from its first.
        """
        member_of = np.searchsorted(self._begins, agents, side="right") - 1
        shape = (len(agents), width) if width else len(agents)
        answers: np.ndarray = np.zeros(shape, dtype)
        is_answered = False
        for k, member in enumerate(self.members):
            rows = np.flatnonzero(member_of == k)
            if not len(rows):
                continue
            begin, end = self._begins[k : k + 2]
            answer = ask(member, slice(begin, end), agents[rows] - begin)
            if answer is not None:
                answers[rows] = answer
                is_answered = True
        return answers if is_answered else None


def _largest(*groups: Group) -> Group:
    """Return the first of these forms of a group, with the largest radius."""
    return replace(groups[0], radius=max(group.radius for group in groups))


def _states(trajectory: Trajectory) -> tuple[str, ...]:
    return trajectory.states.names


def _speeds(trajectory: Trajectory) -> np.ndarray:
    return trajectory.gaits.paces.speeds
