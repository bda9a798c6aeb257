"""How an action plays: by the meters that its agent walks, a stride in a cycle, or by time."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum, auto

import numpy as np

# A character that travels so many times faster or slower than all its agents does not walk by it.
APART = 3.0
PERSON = 2.0  # meters, the diameter of the sphere that holds a person who walks
AHEAD = np.cos(np.radians(45))  # of Forward's four axes: farther aside another is nearer


class Plays(StrEnum):
    """How an action plays, and why."""

    # by a stride
    GIVEN = auto()  # a custom property says so
    WAY = auto()  # as far as it travels
    FEET = auto()  # as far as its feet walk
    # by time
    IN_PLACE = auto()  # it travels nowhere
    OFF_SPEED = auto()  # it travels at another speed than its agents
    ASIDE = auto()  # it travels, but not along Forward
    NOBODY_WALKS = auto()  # it travels, and its agents stand


BY_STRIDE = (Plays.GIVEN, Plays.WAY, Plays.FEET)


@dataclass(frozen=True)
class Cycle:
    """What a character does in a cycle of an action.

    seconds: it lasts.
    way: (2,) meters that it travels, along x and y.
    feet: meters that its feet walk; 0 if they stand, or if that is not known.
    size: meters, the diameter of the character's bounding sphere.
    """

    seconds: float
    way: tuple[float, float]
    feet: float
    size: float

    def speed(self, length: float) -> float:
        """Return at how many m/s a person would go so far in a cycle, measured by its own size."""
        size_seconds = self.size * self.seconds
        return PERSON * length / size_seconds if size_seconds else 0.0


def how_it_plays(
    given: float, cycle: Cycle, forward: tuple[float, float], speeds: Sequence[float]
) -> Plays:
    """Return how an action plays.

    given: meters, a stride that a custom property gives; 0 without.
    forward: (2,) the unit vector that the character faces.
    speeds: m/s, of the agents that play it.
    """
    if given:
        return Plays.GIVEN
    walked = [speed for speed in speeds if speed > 0]
    travels = _judge_way(cycle, forward, walked)
    # feet that go back as slowly as a character drifts do not walk
    steps = any(APART * cycle.speed(cycle.feet) >= speed for speed in walked)
    return Plays.FEET if steps and travels is not Plays.WAY else travels


def _judge_way(cycle: Cycle, forward: tuple[float, float], speeds: Sequence[float]) -> Plays:
    """Return Plays.WAY if agents of these `speeds` walk by its way; else why they do not."""
    length = float(np.hypot(*cycle.way))
    if not length:
        return Plays.IN_PLACE
    if not speeds:
        return Plays.NOBODY_WALKS
    if np.dot(cycle.way, forward) < AHEAD * length:
        return Plays.ASIDE
    speed = cycle.speed(length)
    near = any(speed <= APART * each and each <= APART * speed for each in speeds)
    return Plays.WAY if near else Plays.OFF_SPEED
