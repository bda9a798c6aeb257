"""Which of the work a crowd does not need (crowd/leave_outs.py)."""

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import BLOCKS, NOTHING, STILL, LeftOut
from ..crowd.state_machine import StateMachine
from . import morton_order
from .maps import LabelMap


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
