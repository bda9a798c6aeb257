"""Phase classes: agents share a few phases of their action.

A renderer then poses a few characters instead of every agent.

The phase of a walk is arbitrary; only its advance must be right. So an agent's phase is one of
CLASSES (crowd/agents.py) at first, and then linear in time: class / CLASSES + rate x seconds. The
class is part of the agent's state. It changes only when another state or label gives the agent
another pace, which is an action at a speed: the agent then takes the class whose phase at the new
pace is nearest, at most half a class away. So feet keep step from a walk to a run, and agents that
begin to wait are not in step, because they were not before.

CLASSES is 16. An agent that sets off or stops then jumps by half a class at most, which is one
frame of a walk (a cycle takes 24 to 32). Classes are drawn at random, so two neighbors of one group
are in step only by chance, once in 16. Classes by place would mix within seconds, because agents
walk through each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..crowd.agents import Crowd, Group
from ..crowd.paces import Paces


@dataclass(frozen=True)
class Gaits:
    """The rates at which the groups play their actions.

    classes: the number of phases that agents share.
    paces: the P paces of the state machine.
    rates: (G, P) float64, cycles per second of each group at each pace.
    played: (G, P) bool, which groups may play at which paces; None for all.
    """

    classes: int
    paces: Paces
    rates: np.ndarray
    played: np.ndarray | None = None

    @cached_property
    def actions(self) -> tuple[str, ...]:
        """The names of the actions that are played, in order; "" for the groups' own."""
        return tuple(sorted({*self.paces.actions})) or ("",)

    @cached_property
    def action(self) -> np.ndarray:
        """(P,) intp: which of `actions` is played at each pace."""
        names = self.paces.actions or ("",) * len(self.paces.speeds)
        return np.array([self.actions.index(name) for name in names], np.intp)

    @cached_property
    def plays(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """For each group what it plays, without repeats: (which of `actions`, rate), increasing.

        The first action at rate 0 alone if the group plays nothing.
        """
        played = np.ones(self.rates.shape, bool) if self.played is None else self.played
        paces = [np.flatnonzero(paces_of_group) for paces_of_group in played]
        return tuple(
            tuple(sorted({self._pair(g, int(p)) for p in paces_of_group} or {(0, 0.0)}))
            for g, paces_of_group in enumerate(paces)
        )

    @cached_property
    def distinct(self) -> tuple[np.ndarray, ...]:
        """For each group the rates of what it `plays`."""
        return tuple(np.array([rate for _, rate in own]) for own in self.plays)

    def _pair(self, g: int, p: int) -> tuple[int, float]:
        return int(self.action[p]), float(self.rates[g, p].round(9))

    @cached_property
    def play_number(self) -> np.ndarray:
        """(G, P) intp: which of what it `plays` each group plays at each pace; 0 where it does not
        play.
        """
        numbers = np.zeros(self.rates.shape, np.intp)
        for g, own in enumerate(self.plays):
            number = {pair: k for k, pair in enumerate(own)}
            numbers[g] = [number.get(self._pair(g, p), 0) for p in range(numbers.shape[1])]
        return numbers

    def phase(
        self, crowd: Crowd, seconds: float, agents: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Return the phases (m,) float32 in [0, 1) of `agents` in their action's cycle.

        seconds: time after frame 0.
        agents: (m,) indices, or a slice.
        """
        rate = self.rates[crowd.group[agents], crowd.playing[agents]]
        cycles = crowd.phase_class[agents] / self.classes + rate * seconds
        phase = (cycles % 1.0).astype(np.float32)
        phase[phase >= 1] = 0  # a float64 just below 1 may have rounded up
        return phase

    def continue_phases(self, before: Crowd, after: Crowd, seconds: float) -> Crowd:
        """Return the crowd `after` with phases that continue those of `before`.

        before: the crowd whose paces held until now.
        after: the crowd at `seconds` after frame 0. Agents whose pace has changed get the class
            with the phase nearest to the one they had.
        """
        if after.playing is before.playing:
            return after
        agents = np.flatnonzero(after.playing != before.playing)
        group = after.group[agents]
        rate_before = self.rates[group, before.playing[agents]]
        rate_after = self.rates[group, after.playing[agents]]
        ahead = (rate_before - rate_after) * seconds % 1.0
        classes = after.phase_class.copy()
        classes[agents] = np.rint(classes[agents] + self.classes * ahead) % self.classes
        return replace(after, phase_class=classes)


def gaits_of(
    groups: Sequence[Group], paces: Paces, classes: int, with_agents: np.ndarray | None = None
) -> Gaits:
    """Return the gaits of `groups` at the `paces` of a state machine.

    classes: the number of phases that agents share.
    with_agents: the groups that have agents; None for all. Others need not know the actions.
    CrowdError if an action was not measured for a group that has agents.
    """
    needed = np.unique(np.arange(len(groups)) if with_agents is None else with_agents)
    rates = np.zeros((len(groups), len(paces.speeds)))
    plays = np.ones(rates.shape, bool)
    for p, name in enumerate(paces.actions or ("",) * len(paces.speeds)):
        able = np.array([g in needed or group.knows(name) for g, group in enumerate(groups)])
        able_groups = [groups[g] for g in np.flatnonzero(able).tolist()]
        per_meter, per_second = cycles_of(able_groups, name).T
        rates[able, p] = per_meter * paces.speeds[p] + per_second
        plays[:, p] = able
    return Gaits(classes, paces, rates, None if plays.all() else plays)


def first_blocks(gaits: Gaits) -> np.ndarray:
    """Return the first block of each group, (G + 1,) intp, and the number of blocks.

    A group has one for each of the actions and rates that it plays (Gaits.plays).
    """
    return np.cumsum([0, *(len(played) for played in gaits.plays)])


def cycles_of(groups: Sequence[Group], action: str = "") -> np.ndarray:
    """Return (G, 2) float64: cycles of each group's action per meter and per second.

    action: its name, "" for each group's own.

    An action with a stride plays by the meters walked, any other by time; the other number is 0.
    Both are 0 for one with neither stride nor period.
    """
    played = [group.action(action) for group in groups]
    cycles = [
        (1 / a.stride, 0.0) if a.stride > 0 else (0.0, 1 / a.period if a.period > 0 else 0.0)
        for a in played
    ]
    return np.array(cycles).reshape(-1, 2)


@dataclass(frozen=True)
class Roles:
    """What the characters of a Cast play. A block is what one group plays at one rate.

    block: (N,) intp, the block of each character; -1 for those of groups that are posed.
    phase_class: (N,) uint8, its class in the block.
    family: (B,) intp, for each block a number that those share which the same rigs move; -1 for
        those of groups that are posed.
    """

    block: np.ndarray
    phase_class: np.ndarray
    family: np.ndarray


@dataclass(frozen=True)
class Cast:
    """The characters that agents of a LOD may show.

    They are numbered from 0 through all groups.

    posed: (G,) intp, the number of even phases at which a group is posed, in each of its actions. 0
        for a group with rigs: it has one rig for each of its different actions and rates, and each
        class.
    """

    posed: np.ndarray

    def first(self, gaits: Gaits) -> np.ndarray:
        """Return (G + 1,) intp: the index of each group's first character, and the total."""
        rigs = [gaits.classes * len(own) for own in gaits.distinct]
        poses = self.posed * len(gaits.actions)
        return np.append(0, np.cumsum(np.where(self.posed > 0, poses, rigs)))

    def owner(self, gaits: Gaits) -> np.ndarray:
        """Return the group of each character, (N,) intp."""
        return np.repeat(np.arange(len(self.posed)), np.diff(self.first(gaits)))

    def roles(self, gaits: Gaits, moved_as: np.ndarray | None = None) -> Roles:
        """Return what each character plays.

        moved_as: (N,) intp, of the method of that name; None if no groups share rigs.
        """
        first = self.first(gaits)
        blocks = first_blocks(gaits)
        block = np.full(first[-1], -1, np.intp)
        phase_class = np.zeros(first[-1], np.uint8)
        leaders = np.full(blocks[-1], -1, np.intp)  # the first character of each block
        for g in np.flatnonzero(self.posed == 0):
            number = np.arange(first[g + 1] - first[g])
            block[first[g] : first[g + 1]] = blocks[g] + number // gaits.classes
            phase_class[first[g] : first[g + 1]] = number % gaits.classes
            leaders[blocks[g] : blocks[g + 1]] = first[g] + number[:: gaits.classes]
        leads = leaders if moved_as is None else moved_as[leaders]
        return Roles(block, phase_class, np.where(leaders >= 0, block[leads], -1))

    def moved_as(self, gaits: Gaits, leads: Sequence[int]) -> np.ndarray:
        """Return for each character that whose rigs move it, (N,) intp.

        leads: (G,), for each group that whose rigs move it; they share those of one action, rate
            and class.
        """
        first_of: dict[tuple, int] = {}
        first = self.first(gaits)
        movers = np.arange(first[-1])
        for g in np.flatnonzero(self.posed == 0).tolist():
            for number in range(first[g], first[g + 1]):
                play, phase_class = divmod(number - int(first[g]), gaits.classes)
                movers[number] = first_of.setdefault(
                    (leads[g], *gaits.plays[g][play], phase_class), number
                )
        return movers

    def character_of(
        self, gaits: Gaits, crowd: Crowd, seconds: float, agents: np.ndarray
    ) -> np.ndarray:
        """Return (m,) int32: the index of the character that each agent shows.

        seconds: time after frame 0.
        agents: (m,) indices.
        """
        group = crowd.group[agents]
        first = self.first(gaits)
        first_of_play = (first[:-1, None] + gaits.play_number * gaits.classes).astype(np.int32)
        number = first_of_play[group, crowd.playing[agents]] + crowd.phase_class[agents]
        if self.posed.any():
            count = self.posed[group]
            nearest = np.rint(gaits.phase(crowd, seconds, agents) * count) % np.maximum(count, 1)
            before = first[group] + gaits.action[crowd.playing[agents]] * count
            number = np.where(count > 0, before + nearest.astype(np.intp), number)
        return number.astype(np.int32, copy=False)
