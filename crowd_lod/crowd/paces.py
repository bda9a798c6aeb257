"""Paces: the actions that agents play, at some speeds each, and the steps of their cross-fades.

A step of a cross-fade is an action of its own, in which two actions play at one phase:
`walk > idle 1/4` is a quarter of idle. So rigs, spheres, deviations, bakes and USD take it as any
action, at the rate of the action that is faded to: 3 x 16 rigs a pair of actions and group.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import CrowdError

LEAST = 1e-9  # m/s
MOST_PACES = 6  # of an action: each has its own posed characters
MOST_NUMBERS = 255  # of paces: they are counted in a byte
FADE_STEPS = 3  # of a cross-fade: a quarter, a half, three quarters of the action to come
BETWEEN = " > "  # two actions in the name of a step
FADE_STEP = re.compile(rf"(.*){BETWEEN}(.*) ([1-{FADE_STEPS}])/{FADE_STEPS + 1}", re.DOTALL)


@dataclass(frozen=True)
class Paces:
    """The actions that agents play, each at some speeds: a pace is an action at a speed.

    speeds: (P,) float64, meters per second, increasing within an action.
    of: (S, L) uint8, the pace of an agent in each state on each label.
    off: the largest relative difference between a pace and the agent's own speed. The feet slide by
        it.
    actions: P names, the action of each pace, "" for the groups' own; () if all play their own.
    slowest: (S,) uint8, the first pace of each state's action; () if all play their own. If agents
        can stand, it is the pace at which they stand.
    fades: (P, Q) int16, for an agent that shows a pace of the P and changes to one of the first Q:
        the pace that is the first step of the cross-fade, -1 without one. The paces from Q on are
        steps of cross-fades, FADE_STEPS of each in a row. () without any.
    """

    speeds: np.ndarray
    of: np.ndarray
    off: float = 0.0
    actions: tuple[str, ...] = ()
    slowest: np.ndarray | tuple[()] = ()
    fades: np.ndarray | tuple[()] = ()

    @cached_property
    def action(self) -> np.ndarray:
        """(P,) intp: a number for the action of each pace."""
        names = self.actions or ("",) * len(self.speeds)
        return np.array([names.index(name) for name in names], np.intp)

    def first_step(self, steps: np.ndarray) -> np.ndarray:
        """Return the first step of the cross-fade of each of `steps`, (n,) paces."""
        plain = np.shape(self.fades)[1]
        return steps - (steps - plain) % FADE_STEPS


def step_name(before: str, after: str, step: int) -> str:
    """Return the name of a step, 1 to FADE_STEPS, of the cross-fade between two actions."""
    return f"{before}{BETWEEN}{after} {step}/{FADE_STEPS + 1}"


def mixed_in(name: str) -> tuple[str, str, float] | None:
    """Return what the step of a cross-fade called `name` is mixed of; None if it is an action.

    That is (action before, action after, share of the latter).
    """
    match = FADE_STEP.fullmatch(name)
    return match and (match[1], match[2], int(match[3]) / (FADE_STEPS + 1))


def paces_of(
    actions: Sequence[str], speed: np.ndarray, stops: bool, pairs: Collection[tuple[str, str]]
) -> Paces:
    """Return the paces of a table: for each action its speeds, at most MOST_PACES of them.

    If an action has more, the paces rise by equal ratios from its slowest speed to its fastest,
    and each speed gets the nearest pace by ratio. Standing, where agents can, is a pace of its
    own.

    actions: S names, "" for the groups' own.
    speed: (S, L) float64 m/s.
    stops: whether the map's edge makes agents stand.
    pairs: the actions (before, after) that cross-fade.
    CrowdError if that is more than MOST_NUMBERS.
    """
    of = np.zeros(speed.shape, np.intp)
    slowest = np.zeros(len(speed), np.intp)
    speeds: list[float] = []
    names: list[str] = []
    off = 0.0
    for action in dict.fromkeys(sorted(actions)):
        states = [s for s, name in enumerate(actions) if name == action]
        paces, nearest = _ladder(speed[states], stops)
        of[states] = len(names) + nearest
        slowest[states] = len(names)
        off = max(off, float(np.abs(_ratio(paces[nearest], speed[states]) - 1.0).max()))
        speeds += paces.tolist()
        names += [action] * len(paces)
    plain = len(names)
    steps = FADE_STEPS * len(pairs)
    if plain + steps > MOST_NUMBERS:
        raise CrowdError(
            f"The state machine has {plain + steps} paces, {steps} of them steps of cross-fades, "
            f"and can have {MOST_NUMBERS}: give fewer states an action or a fade."
        )
    fades = _fades(names, sorted(pairs))
    for name in names[plain:]:
        _, after, _ = mixed_in(name) or ("", "", 0)
        walks = [
            pace
            for pace, action in zip(speeds, names[:plain], strict=False)
            if action == after and pace
        ]
        speeds.append(walks[len(walks) // 2] if walks else 0.0)
    off = off if off > 1e-6 else 0.0
    if not any(names):
        return Paces(np.array(speeds), of.astype(np.uint8), off)
    return Paces(
        np.array(speeds), of.astype(np.uint8), off, tuple(names), slowest.astype(np.uint8), fades
    )


def _fades(names: list[str], pairs: Sequence[tuple[str, str]]) -> np.ndarray | tuple[()]:
    """Add the steps of all cross-fades to the paces' action `names`; return Paces.fades."""
    if not pairs:
        return ()
    plain = len(names)
    first = {pair: plain + FADE_STEPS * k for k, pair in enumerate(pairs)}
    names += [step_name(*pair, step) for pair in pairs for step in range(1, FADE_STEPS + 1)]
    fades = np.full((len(names), plain), -1, np.int16)
    for p, name in enumerate(names):
        before, after, share = mixed_in(name) or (name, name, 0.0)
        # an interrupted cross-fade goes on from the action that weighs more
        shown = after if share >= 0.5 else before
        for q in range(plain):
            fades[p, q] = first.get((shown, names[q]), -1)
    return fades


def _ladder(speed: np.ndarray, stops: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the paces (p,) that serve all of `speed` (s, L), and the pace (s, L) of each."""
    # ten digits, whatever the unit of length; who is slower than LEAST stands
    digits = 9 - int(np.floor(np.log10(speed.max(initial=LEAST))))
    rounded = speed.round(digits)
    stands = [0.0] if stops or not rounded.all() else []
    walks = np.unique(rounded[rounded > 0])
    if len(stands) + len(walks) > MOST_PACES:
        walks = np.geomspace(walks[0], walks[-1], MOST_PACES - len(stands))
    paces = np.array([*stands, *walks])
    ratio = np.log(np.maximum(speed, LEAST))[..., None] - np.log(np.maximum(paces, LEAST))
    return paces, np.abs(ratio).argmin(axis=-1)


def _ratio(pace: np.ndarray, speed: np.ndarray) -> np.ndarray:
    return np.divide(pace, speed, out=np.ones_like(speed), where=speed > 0)
