"""Cross-fades of agents between the actions of their states, step by step."""

from dataclasses import replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.paces import FADE_STEPS
from ..crowd.state_machine import StateMachine

# Part of a cross-fade by which a step begins early: shares add up with rounding.
EARLY = 1e-4


def fade(before: Crowd, after: Crowd, machine: StateMachine, seconds: float) -> Crowd:
    """Return the crowd `after` with the paces that its agents show.

    before: the crowd `seconds` earlier, with the paces that it showed then.
    after: the crowd after a step of behavior. An agent whose new state plays another action begins
        to fade into it, in the middle of the step. The fade lasts as long as the state's `fade`,
        and the new action's weight rises in FADE_STEPS steps. Where a fade is interrupted, the next
        one begins with the action that weighs more, if there is such a fade.
    """
    if before.played is None or before.faded is None:
        return after
    is_fading = before.faded < 1
    if after.pace is before.pace and not is_fading.any():
        return after
    paces = machine.paces
    played = after.pace.copy()
    faded = np.ones_like(before.faded)

    agents = np.flatnonzero(is_fading)
    share = before.faded[agents] + _share_of(machine.fading, after, agents, seconds)
    _show(played, faded, agents, paces.first_step(before.played[agents]), share)

    agents = np.flatnonzero(paces.action[after.pace] != paces.action[before.pace])
    played[agents] = after.pace[agents]
    faded[agents] = 1
    first = np.asarray(paces.fades)[before.played[agents], after.pace[agents]]
    begins = first >= 0
    agents = agents[begins]
    share = _share_of(machine.fade, after, agents, seconds / 2)
    _show(played, faded, agents, first[begins], share)
    return replace(after, played=played, faded=faded)


def _share_of(length: np.ndarray, crowd: Crowd, agents: np.ndarray, seconds: float) -> np.ndarray:
    """Return the part of their cross-fades, (k,) float32, that `seconds` are.

    length: (S,) seconds of a cross-fade in each state. The part is inf where it is 0.
    agents: (k,) intp.
    """
    with np.errstate(divide="ignore"):
        return (seconds / length[crowd.state[agents]]).astype(np.float32)


def _show(
    played: np.ndarray, faded: np.ndarray, agents: np.ndarray, first: np.ndarray, share: np.ndarray
) -> None:
    """Write to `played` and `faded` what agents show whose cross-fades go on.

    agents: (k,) intp.
    first: (k,) the first step of each one's cross-fade.
    share: (k,) float32, the part of it that is over; from 1 on it has ended.
    """
    goes_on = share < 1 - EARLY
    agents = agents[goes_on]
    share = share[goes_on]
    faded[agents] = share
    played[agents] = first[goes_on] + ((share + EARLY) * FADE_STEPS).astype(np.intp)
