"""Which of the state machine's work a crowd does not need."""

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from .maps import LabelMap


def stays_still(crowd: Crowd, machine: StateMachine, world: LabelMap) -> bool:
    """Return whether nobody of a crowd that starts as `crowd` ever moves or changes its state."""
    labels = np.flatnonzero(np.bincount(world.labels.ravel(), minlength=len(machine.labels)))
    states = np.flatnonzero(_reached(machine, crowd.state, labels))
    rules = np.ix_(states, labels)
    stays = bool((machine.next_state[rules] == states[:, None]).all())
    draws = bool((machine.next_choice[rules] >= 0).any())
    moves = bool(machine.velocity[rules].any())
    fading = crowd.faded is not None and bool((crowd.faded < 1).any())
    return stays and not (draws or moves or machine.timed or fading)


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
