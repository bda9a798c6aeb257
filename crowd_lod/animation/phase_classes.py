"""Phase classes: agents share a few phases of their action, so that a renderer poses a few characters and not each agent.

Which phase of its walk an agent is in is arbitrary; only its advance must be right. So a phase is chosen from CLASSES of them,
and from then on it is a straight line in time: class / CLASSES + rate x seconds. A class is part of an agent's state. It changes
only where the agent's pace does, when another state or label gives it another speed: to the class of the new pace whose phase is
nearest, at most half a class away.

CLASSES is 16: half a class is then a frame of a walk (a cycle takes 24 to 32), the most that an agent jumps where it sets off or
stops. Classes are drawn at random, so that two neighbours of one group are in step as often as by chance, once in 16; classes by
place would mix within seconds, for agents walk through each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..crowd.agents import Crowd, Group
from ..crowd.state_machine import Paces


@dataclass(frozen=True)
class Gaits:
    """How the groups play their actions. classes: phases that agents share; rates: (G, P) float64, cycles per second that each
    group plays at each pace of `paces`."""

    classes: int
    paces: Paces
    rates: np.ndarray

    @cached_property
    def distinct(self) -> tuple[np.ndarray, ...]:
        """Of each group its rates, rising, those that are alike once."""
        return tuple(np.unique(rates.round(9)) for rates in self.rates)

    @cached_property
    def which(self) -> np.ndarray:
        """(G, P) intp: which of its distinct rates each group plays at each pace."""
        return np.array([np.searchsorted(own, rates.round(9)) for own, rates in zip(self.distinct, self.rates, strict=True)])

    def phase(self, crowd: Crowd, seconds: float, agents: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(m,) float32 in [0, 1): the place of `agents` (m,) in their action's cycle, `seconds` after frame 0."""
        rate = self.rates[crowd.group[agents], crowd.pace[agents]]
        phase = ((crowd.phase_class[agents] / self.classes + rate * seconds) % 1.0).astype(np.float32)
        phase[phase >= 1] = 0  # a float64 just below 1 may have rounded up
        return phase

    def joined(self, before: Crowd, after: Crowd, seconds: float) -> Crowd:
        """The crowd `after`, `seconds` after frame 0, whose agents walked at the paces of `before` until then: those of
        another pace are in the class that is nearest to the phase that they had."""
        if after.pace is before.pace:
            return after
        (who,) = np.nonzero(after.pace != before.pace)
        group = after.group[who]
        ahead = (self.rates[group, before.pace[who]] - self.rates[group, after.pace[who]]) * seconds
        classes = after.phase_class.copy()
        classes[who] = np.rint(classes[who] + self.classes * (ahead % 1.0)) % self.classes
        return replace(after, phase_class=classes)


def gaits_of(groups: Sequence[Group], paces: Paces, classes: int) -> Gaits:
    """The gaits of `groups` at the `paces` of a state machine."""
    per_metre, per_second = cycles_of(groups).T[:, :, None]
    return Gaits(classes, paces, per_metre * paces.speeds + per_second)


def cycles_of(groups: Sequence[Group]) -> np.ndarray:
    """(G, 2) float64: how many cycles of the action each group plays per metre walked, and per second."""
    return np.array([(1 / g.stride, 0.0) if g.stride > 0 else (0.0, 1 / g.period if g.period > 0 else 0.0) for g in groups])


@dataclass(frozen=True)
class Library:
    """The characters that agents of a LOD may show, counted from 0 through all groups. posed: (G,) intp, of a group that has
    poses, at how many even phases; 0 of one that has rigs: those have one for each of the group's rates and each class.
    times: (G,) intp, how often a group's poses follow one another: more than once in builds from before there were rigs, which
    had poses for several paces; the first are shown."""

    posed: np.ndarray
    times: np.ndarray | int = 1

    def first(self, gaits: Gaits) -> np.ndarray:
        """(G + 1,) intp: where each group's begin, and where all end."""
        rigs = [gaits.classes * len(rates) for rates in gaits.distinct]
        return np.append(0, np.cumsum(np.where(self.posed > 0, self.posed * self.times, rigs)))

    def shown(self, gaits: Gaits, crowd: Crowd, seconds: float, agents: np.ndarray) -> np.ndarray:
        """(m,) int32: which of them each of `agents` (m,) shows, `seconds` after frame 0."""
        group = crowd.group[agents]
        number = gaits.which[group, crowd.pace[agents]] * gaits.classes + crowd.phase_class[agents]
        if self.posed.any():
            count = self.posed[group]
            nearest = np.rint(gaits.phase(crowd, seconds, agents) * count) % np.maximum(count, 1)
            number = np.where(count > 0, nearest.astype(np.intp), number)
        return (self.first(gaits)[group] + number).astype(np.int32)
