"""Wardrobes: the slots of a character group, and who wears which of their parts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..format import counted
from . import random_streams
from .agents import Group


@dataclass(frozen=True)
class Slot:
    """A slot of a wardrobe.

    name: the same for the same slot of other groups.
    parts: indices of the groups that are its parts.
    chances: of each part; what is left to 1 is the chance of none.
    wearer: index of the group whose agents have the slot.
    """

    name: str
    parts: tuple[int, ...]
    chances: tuple[float, ...]
    wearer: int


def slots_of(groups: Sequence[Group]) -> list[Slot]:
    """Return the slots of all wardrobes among `groups`, by name."""
    names = [group.name for group in groups]
    parts: dict[tuple[str, str], list[int]] = {}
    for g, group in enumerate(groups):
        if group.slot:
            parts.setdefault((group.slot, group.variant_of), []).append(g)
    return [
        Slot(
            name,
            tuple(members),
            tuple(groups[g].chance for g in members),
            names.index(owner),
        )
        for (name, owner), members in sorted(parts.items())
    ]


def count_people(rows: int, worn: int) -> str:
    """Return in words how many agents there are in `rows`, `worn` of which are what they wear."""
    people = counted(rows - worn, "agent")
    return f"{people} ({counted(worn, 'accessory', 'accessories')})" if worn else people


def draw_parts(
    groups: Sequence[Group], group: np.ndarray, key: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (wearer (m,) intp, part (m,) uint8) of all that is worn, sorted by part, then wearer.

    group: (n,) uint8, of each agent.
    key: (n,) uint64, the agents' first keys. An agent's parts depend on its key alone.

    Slots are asked in the order of their names: a part that is still worn takes off the slots that
    it excludes.
    """
    slots = slots_of(groups)
    worn = [_drawn(slot, group, key) for slot in slots]
    for parts in worn:
        for g in np.unique(parts[parts >= 0]).tolist():
            wears = parts == g
            for slot, others in zip(slots, worn, strict=True):
                if slot.name in groups[g].excludes:
                    others[wears] = -1
    wearers = [np.flatnonzero(parts >= 0) for parts in worn]
    wearer = np.concatenate([np.empty(0, np.intp), *wearers])
    part = np.concatenate(
        [
            np.empty(0, np.uint8),
            *(parts[agents].astype(np.uint8) for parts, agents in zip(worn, wearers, strict=True)),
        ]
    )
    order = np.argsort(part, kind="stable")
    return wearer[order], part[order]


def _drawn(slot: Slot, group: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Return the part of the slot that is drawn for each agent, (n,) int16; -1 for none."""
    parts = np.full(len(group), -1, np.int16)
    agents = np.flatnonzero(group == slot.wearer)
    draw = random_streams.uniform(key[agents], random_streams.named(slot.name))
    choice = np.searchsorted(np.cumsum(slot.chances), draw, side="right")
    parts[agents] = np.append(slot.parts, -1)[choice]
    return parts
