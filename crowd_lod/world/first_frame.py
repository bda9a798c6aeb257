"""The crowd's first frame: agents at random places (chapter section 1.2, "Populating"), and whether
any of them will ever move.
"""

from collections.abc import Sequence

import numpy as np

from ..crowd import random_streams
from ..crowd.agents import CLASSES, IN_PLACE, MOST_AGENTS, MOST_GROUPS, Crowd, Draw, Shares
from ..crowd.state_machine import StateMachine
from ..errors import CrowdError
from ..format import counted
from . import morton_order
from .maps import LabelMap


def populate(
    count: int,
    seed: int,
    groups: Shares,
    machine: StateMachine,
    world: LabelMap,
    classes: int = CLASSES,
) -> Crowd:
    """Return the crowd's first frame: `count` agents at random positions.

    The same arguments give the same crowd, bit for bit.

    Position: uniform on the labels where `machine` lets agents spawn.
    State: by the start weights of `machine`.
    Group: uniform, of as many as `groups` says, or by the weights in it.
    Phase: uniform, of `classes`.
    Heading: that of the first move; uniform for agents that stand.

    Agents of one group follow one another. From IN_PLACE agents on, each group follows a Morton
    curve.

    CrowdError if a count is out of range, or if no label lets agents spawn.
    """
    check_counts(count, groups)
    open_cells = np.flatnonzero(machine.spawn[world.labels])
    if not len(open_cells):
        raise CrowdError(
            "The map has no place where agents may spawn: paint a label whose spawn is true."
        )
    random = np.random.Generator(np.random.PCG64(seed))
    cell = open_cells[random.integers(len(open_cells), size=count)]
    row, column = np.divmod(cell, world.labels.shape[1])
    x = world.area.x_min + (column + random.random(count)) * world.cell[0]
    y = world.area.y_min + (row + random.random(count)) * world.cell[1]
    points = x, y, np.full(count, world.area.z)
    return place_agents(points, None, random, (seed, groups, classes), machine, world)


def _groups(groups: Shares, count: int, random: np.random.Generator) -> np.ndarray:
    """Return a group for each of `count` agents, (n,) uint8, increasing; see populate."""
    if isinstance(groups, Draw):
        return groups.groups[_groups(groups.weights, count, random)]
    if isinstance(groups, int):
        return np.sort(random.integers(groups, size=count, dtype=np.uint8))
    until = np.cumsum(groups)
    if not 0 < until[-1] < np.inf:
        raise CrowdError(
            "The shares of the crowd's character groups sum to nothing: give one a share above 0."
        )
    drawn = np.searchsorted(until[:-1] / until[-1], random.random(count), side="right")
    return np.sort(drawn.astype(np.uint8))


def check_counts(count: int, groups: Shares = 1) -> None:
    """Raise CrowdError if a count of agents or of groups is out of range; groups: see populate."""
    groups = groups if isinstance(groups, int) else len(groups)
    if not 1 <= count <= MOST_AGENTS:
        raise CrowdError(
            f"The crowd has {counted(count, 'agent')}: set Agents to a number from 1 to "
            f"{MOST_AGENTS:,}."
        )
    if not 1 <= groups <= MOST_GROUPS:
        raise CrowdError(f"The crowd has {groups} character groups; give it 1 to {MOST_GROUPS}.")


def place_agents(
    points: Sequence[np.ndarray],
    heading: np.ndarray | None,
    random: np.random.Generator,
    numbers: tuple[int, Shares, int],
    machine: StateMachine,
    world: LabelMap,
) -> Crowd:
    """Return a crowd at the points x, y, z, (n,) each; see populate.

    heading: (n,) float32, NaN for agents that are to get one; None for all.
    random: gives all that is drawn.
    numbers: seed of the agents' own streams, groups (see populate), classes.
    """
    x, y, z = points
    seed, groups, classes = numbers
    count = len(x)
    until = np.cumsum(machine.start)[:-1]
    state = np.searchsorted(until, random.random(count), side="right").astype(np.uint8)
    group = _groups(groups, count, random)
    phase = (random.random(count, dtype=np.float32) * np.float32(classes)).astype(np.uint8)
    label = world.at(x, y)
    pace = machine.paces.of[state, label]
    vx, vy = machine.velocity[state, label].T
    any_heading = random.uniform(-np.pi, np.pi, count)
    moves = (vx != 0) | (vy != 0)
    first_heading = np.where(moves, np.arctan2(vy, vx), any_heading).astype(np.float32)
    if heading is None:
        heading = first_heading
    else:
        heading = np.where(np.isnan(heading), first_heading, heading)
    if count >= IN_PLACE:
        order = morton_order.order_of(x, y, group, world.area)
        x, y, z, heading, state, group, phase, pace = (
            column[order] for column in (x, y, z, heading, state, group, phase, pace)
        )
    key = random_streams.keys(seed, count)
    return Crowd(x, y, z, heading, state, group, phase, machine.waits(state, key), key, pace=pace)


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
