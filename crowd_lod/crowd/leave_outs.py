"""The work that a scene does not need, each part with its reason.

A plan without it is the same as the full pipeline's, bit for bit.
"""

from dataclasses import dataclass

import numpy as np

from . import morton_order
from .agents import Crowd
from .maps import LabelMap
from .state_machine import StateMachine


# compared by identity: a frame asks for these many times
@dataclass(frozen=True, eq=False)
class LeftOut:
    """A part of the pipeline's `stage` that a scene does not need, and why."""

    stage: str
    reason: str


STATIC = LeftOut("plan", "Neither an agent nor the camera moves: the plan made before holds.")
STILL = LeftOut(
    "behavior",
    "No agent ever moves or changes its state: behavior ran once, and only the action plays on.",
)
BLOCKS = LeftOut(
    "culling",
    "Agents are in blocks: those of a block outside the picture, or inside and in one LOD, are "
    "not tested.",
)

# Of the agents that the camera does not see (frame/shadows.py).
NO_SHADOWS = LeftOut(
    "surroundings",
    "No light casts shadows: agents outside the picture are not searched for shadows in it.",
)
NO_MIRRORS = LeftOut(
    "surroundings",
    "No mirrors are chosen: agents outside the picture are not searched for reflections in it.",
)
NOT_WANTED = LeftOut(
    "surroundings",
    "Shadows and Reflections is off: agents that the camera does not see are left out.",
)
WORKBENCH = LeftOut(
    "surroundings",
    "Workbench draws no shadows of lights and no reflections: agents that the camera does not see "
    "are left out.",
)

# In the order of the pipeline.
ITEMS = (STATIC, STILL, BLOCKS)
ALL = frozenset(ITEMS)
NOTHING: frozenset[LeftOut] = frozenset()


def needless_of_places(crowd: Crowd) -> frozenset[LeftOut]:
    """Return the work that no frame of the `crowd` needs, whoever moves it."""
    return frozenset([BLOCKS]) if len(crowd) >= morton_order.FEWEST else NOTHING


def needless(crowd: Crowd, machine: StateMachine, world: LabelMap) -> frozenset[LeftOut]:
    """Return the behavior that no frame of the crowd that starts as `crowd` needs."""
    labels = np.flatnonzero(np.bincount(world.labels.ravel(), minlength=len(machine.labels)))
    states = np.flatnonzero(_reached(machine, crowd.state, labels))
    rules = np.ix_(states, labels)
    stays = bool((machine.next_state[rules] == states[:, None]).all())
    draws = bool((machine.next_choice[rules] >= 0).any())
    moves = bool(machine.velocity[rules].any())
    fading = crowd.faded is not None and bool((crowd.faded < 1).any())
    still = stays and not (draws or moves or machine.timed or fading)
    return frozenset([STILL]) if still else NOTHING


def reachable_velocities(machine: StateMachine, world: LabelMap, states: np.ndarray) -> np.ndarray:
    """Return the velocities (s, l, 2) m/s of all states that agents may be in, by label of the map.

    states: (n,), those in which they start.
    """
    labels = np.flatnonzero(np.bincount(world.labels.ravel(), minlength=len(machine.labels)))
    return machine.velocity[np.ix_(np.flatnonzero(_reached(machine, states, labels)), labels)]


def _reached(machine: StateMachine, start: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return (S,) bool: the states that agents may ever be in.

    start: (n,) states at the start.
    labels: (m,) labels on the map.
    """
    reached = np.bincount(start, minlength=len(machine.states)) > 0
    if machine.chancy:
        return np.ones_like(reached)
    while True:
        states = np.flatnonzero(reached)
        timed = states[np.isfinite(machine.after[states]).any(axis=1)]
        before = reached.sum()
        reached[machine.next_state[np.ix_(states, labels)]] = True
        reached[machine.then[timed]] = True
        if reached.sum() == before:
            return reached
