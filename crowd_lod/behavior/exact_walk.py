"""The exact walk, and the agents that it finds in trouble.

Between two cell borders an agent walks straight at constant velocity, so its way is piecewise
linear and known exactly. The exact walk is the limit of listing 1.1 for ever shorter steps. An
agent reads the table until its state no longer changes, then walks to the next border. Between two
reads it does not move, with one exception: a rule that heads out over the border on which the agent
stands, as a wall's rule does, moves it out.

A step (behavior/plain_step.py) reads once in each piece. So the two agree, up to rounding, wherever
a rule moves as the state that it leads to. Elsewhere an agent keeps the rule's own velocity for at
most a step, and the error is of first order in the step.

Some tables have no limit. The plaza's turns an agent along a house a little at each read, first
toward the wall and then away from it. How many reads that takes depends on where in a step the
agent reached the border, however short the step. The exact walk takes the first way out. Steps of
any length leave such agents equally far from it: see `apart` in validation/behavior_errors.py.
"""

from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..messages import Message, MessageKind
from ..world.maps import LabelMap
from .plain_step import advance


def walk(
    crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float
) -> tuple[Crowd, np.ndarray]:
    """Return (crowd, chatters) `seconds` later, exact up to the rounding of float64.

    The error is a few units in the last place per border.

    chatters: (n,) bool, agents whose state the table changes for ever in one place, so that time
        cannot go on: to and fro over a border, or in a cycle on one label. They stay there. Their
        state is any of those in the cycle. If the states of a cycle move agents, their place is not
        a limit of the steps' places. With random choices, a long enough row of changes counts as
        for ever. Agents between walls that touch at a corner and leave nearly no room are included.
    """
    moved, tally = advance(crowd, machine, world, seconds, exact=True)
    return moved, tally.stuck


@dataclass(frozen=True)
class Trouble:
    """Agents that the table and the map have caught.

    kind: "chatters": the state changes for ever and the agent gets nowhere, or nearly so. "stuck":
        the agent stands for good in a state that walks elsewhere.
    agents: (k,) intp.
    x, y: (p,) float64 world meters, centers of the map cells where the agents are.
    column, row: (p,) intp, these cells; row 0 lies at y_min.
    counts: (p,), agents in each cell, largest first.
    """

    kind: str
    agents: np.ndarray
    x: np.ndarray
    y: np.ndarray
    column: np.ndarray
    row: np.ndarray
    counts: np.ndarray

    @property
    def message(self) -> Message:
        facts = {
            "agents": len(self.agents),
            "cells": len(self.counts),
            "there": int(self.counts[0]),
            "x": float(self.x[0]),
            "y": float(self.y[0]),
            "column": int(self.column[0]),
            "row": int(self.row[0]),
        }
        return Message(
            MessageKind.CHATTERS if self.kind == "chatters" else MessageKind.STUCK, facts=facts
        )


def trouble(
    crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float = 60.0
) -> tuple[Trouble, ...]:
    """Return the troubles that `crowd` is in or walks into within `seconds`.

    Returns at most one Trouble of each kind, () if all is well.

    Both kinds are read from the exact walk, so they are certain, not guessed from a few frames. A
    stuck agent does not move, does not change state and does not wait for a timer. An agent in a
    state that never moves and never ends, on any label, rests there by design and is not counted.
    """
    later, chatters = walk(crowd, machine, world, seconds)
    much_later, chatters_later = walk(later, machine, world, seconds / 60)
    chatters |= chatters_later
    stays = np.ones(len(crowd), bool)
    for name in ("x", "y", "state", "mirror"):
        stays &= getattr(much_later, name) == getattr(later, name)
    stuck = stays & ~chatters & np.isinf(later.wait) & ~_rest_states(machine)[later.state]
    troubles = (
        _trouble_of("chatters", chatters, later, world),
        _trouble_of("stuck", stuck, later, world),
    )
    return tuple(trouble for trouble in troubles if len(trouble.agents))


def _rest_states(machine: StateMachine) -> np.ndarray:
    """Return (S,) bool: states that never move and never end, on any label."""
    states = np.arange(len(machine.states))[:, None]
    keeps = (machine.next_state == states) & (machine.next_choice < 0)
    stands = ~machine.velocity.any(axis=2)
    has_timer = np.isfinite(machine.after[:, 0])
    return (keeps & stands).all(axis=1) & ~has_timer


def _trouble_of(kind: str, caught: np.ndarray, crowd: Crowd, world: LabelMap) -> Trouble:
    agents = np.flatnonzero(caught)
    columns = world.labels.shape[1]
    column, row = world.cells(crowd.x[agents], crowd.y[agents])
    cells, counts = np.unique(row * columns + column, return_counts=True)
    most = np.argsort(-counts, kind="stable")
    row, column = np.divmod(cells[most], columns)
    return Trouble(kind, agents, *world.middles(row, column), column, row, counts[most])
