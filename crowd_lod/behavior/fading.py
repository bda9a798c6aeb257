"""Cross-fades of agents between the actions of their states, step by step."""

from dataclasses import replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.paces import FADE_STEPS
from ..crowd.state_machine import StateMachine

EARLY = 1e-4  # of a cross-fade: by so much a step begins early, as shares add up with rounding


def fading(before: Crowd, after: Crowd, machine: StateMachine, seconds: float) -> Crowd:
    """Return the crowd `after` with the paces that its agents show.

    before: the crowd `seconds` earlier, with the paces that it showed then.
    after: the crowd after a step of behavior. An agent whose state has brought it another action
        begins to fade into it, over the state's `fade`, in the middle of the step; within it the
        action weighs by FADE_STEPS steps. Where a fade is interrupted, the next one begins with the
        action that weighs more, if there is such a fade.
    """
    if before.played is None or before.faded is None:
        return after
    goes = before.faded < 1
    if after.pace is before.pace and not goes.any():
        return after
    paces, played, faded = machine.paces, after.pace.copy(), np.ones_like(before.faded)
    (who,) = goes.nonzero()
    _show(
        played,
        faded,
        who,
        paces.first_step(before.played[who]),
        before.faded[who] + _part(machine.fading, after, who, seconds),
    )
    (who,) = np.nonzero(paces.action[after.pace] != paces.action[before.pace])
    played[who], faded[who] = after.pace[who], 1
    first = np.asarray(paces.fades)[before.played[who], after.pace[who]]
    who, first = who[first >= 0], first[first >= 0]
    _show(played, faded, who, first, _part(machine.fade, after, who, seconds / 2))
    return replace(after, played=played, faded=faded)


def _part(length: np.ndarray, crowd: Crowd, who: np.ndarray, seconds: float) -> np.ndarray:
    """Return the part of a cross-fade, (k,) float32, that `seconds` are; inf where its length (S,)
    is 0.
    """
    with np.errstate(divide="ignore"):
        return (seconds / length[crowd.state[who]]).astype(np.float32)


def _show(
    played: np.ndarray, faded: np.ndarray, who: np.ndarray, first: np.ndarray, share: np.ndarray
) -> None:
    """Write to `played` and `faded` what agents show whose cross-fades go on.

    who: (k,) agents.
    first: (k,) the first step of each one's cross-fade.
    share: (k,) float32, the part of it that is over; from 1 on it has ended.
    """
    on = share < 1 - EARLY
    who, first, share = who[on], first[on], share[on]
    played[who], faded[who] = first + ((share + EARLY) * FADE_STEPS).astype(np.intp), share
