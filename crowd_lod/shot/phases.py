"""Phase classes of a shot, the meetings that are in step by them, and the jumps of a change.

An agent's source gives it one of CLASSES classes (animation/phase_classes.py). The shot's plan adds
a shift to that class, and takes the nearest class of a palette. So the phase still follows from the
crowd at a time alone, at sub-frames and after changes of pace, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from ..animation.phase_classes import Gaits, first_blocks
from ..crowd.agents import CLASSES, Crowd


def palette(count: int) -> np.ndarray:
    """Return `count` of the CLASSES classes, (count,) intp, as even as they can be."""
    return np.rint(CLASSES * np.arange(count) / count).astype(np.intp)


def _nearest_of_palettes() -> np.ndarray:
    """Return (CLASSES + 1, CLASSES) uint8: for a palette's count and a class, its nearest class."""
    classes = np.arange(CLASSES)
    table = np.zeros((CLASSES + 1, CLASSES), np.uint8)
    for count in range(1, CLASSES + 1):
        ahead = (palette(count) - classes[:, None]) % CLASSES
        nearest = np.minimum(ahead, CLASSES - ahead).argmin(axis=1)
        table[count] = palette(count)[nearest]
    return table


NEAREST = _nearest_of_palettes()


@dataclass(frozen=True)
class Phases:
    """The phase classes of a shot.

    shift: (n,) uint8, by how many classes each agent is ahead of its source's class.
    counts: (B,) uint8, the classes of the palette of each block; CLASSES keeps all of them. A block
        is what one group plays: see phase_classes.first_blocks.
    finer: (n,) uint8, how often an agent's palette has twice as many classes: with its block's
        classes it would jump in sight when it changes what it plays.
    """

    shift: np.ndarray
    counts: np.ndarray
    finer: np.ndarray

    def palette_of(self, agents: np.ndarray, block: np.ndarray) -> np.ndarray:
        """Return how many classes the palettes of `agents` (m,) have in `block` (m,), (m,) intp."""
        return np.minimum(self.counts[block].astype(np.intp) << self.finer[agents], CLASSES)

    def classes_of(
        self, agents: np.ndarray, block: np.ndarray, phase_class: np.ndarray
    ) -> np.ndarray:
        """Return the classes (m,) uint8 that `agents` (m,) show.

        block, phase_class: (m,) of each, what it plays and the class of its source.
        """
        return NEAREST[self.palette_of(agents, block), (phase_class + self.shift[agents]) % CLASSES]

    def applied(self, crowd: Crowd, gaits: Gaits) -> Crowd:
        """Return `crowd`, which plays by `gaits`, with the classes of the shot."""
        block = first_blocks(gaits)[:-1, None] + gaits.play_number
        nearest = NEAREST[self.counts[block]]
        ahead = (crowd.phase_class + self.shift) % CLASSES
        classes = nearest[crowd.group, crowd.playing, ahead]
        (finer,) = np.nonzero(self.finer)
        blocks = block[crowd.group[finer], crowd.playing[finer]]
        classes[finer] = self.classes_of(finer, blocks, crowd.phase_class[finer])
        return replace(crowd, phase_class=classes)


@dataclass(frozen=True)
class Meetings:
    """Pairs of agents that are seen close to each other while both play the same.

    pair: (m, 2) int32, agents.
    block: (m, 2) uint16, what each of them plays (phase_classes.Roles).
    classes: (m, 2) uint8, the classes of their sources then.
    frames: (m,) int64, in how many frames of the survey that were looked at.
    weight: (m,) float64, by nearness and size in pixels, summed over these frames.
    """

    pair: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.int32))
    block: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.uint16))
    classes: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.uint8))
    frames: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    weight: np.ndarray = field(default_factory=lambda: np.empty(0))

    def classes_of(self, phases: Phases, side: int) -> np.ndarray:
        """Return the classes (m,) uint8 that the agents of one side, 0 or 1, show."""
        return phases.classes_of(self.pair[:, side], self.block[:, side], self.classes[:, side])

    def in_step(self, phases: Phases) -> np.ndarray:
        """Return which of them have the same class, (m,) bool."""
        return self.classes_of(phases, 0) == self.classes_of(phases, 1)

    def share_in_step(self, phases: Phases) -> float:
        """Return the part of the meetings that are in step, 0 without any."""
        return float(self.frames[self.in_step(phases)].sum() / max(self.frames.sum(), 1))

    def of(self, mask: np.ndarray) -> "Meetings":
        """Return those of the mask `mask`, (m,) bool."""
        return Meetings(
            self.pair[mask],
            self.block[mask],
            self.classes[mask],
            self.frames[mask],
            self.weight[mask],
        )


def joined_meetings(parts: Sequence[Meetings]) -> Meetings:
    """Return the meetings of all parts; those of the same agents that play the same are one."""
    pair, block, classes, frames, weight = (
        np.concatenate([getattr(part, column.name) for part in parts])
        for column in fields(Meetings)
    )
    key = np.column_stack((pair, block, classes))
    order = np.lexsort(key.T)
    key = key[order]
    begins = np.append(True, (key[1:] != key[:-1]).any(axis=1))[: len(key)]
    (first,) = np.nonzero(begins)
    if not len(first):
        return Meetings()
    of_each = order[first]
    return Meetings(
        pair[of_each],
        block[of_each],
        classes[of_each],
        np.add.reduceat(frames[order], first),
        np.add.reduceat(weight[order], first),
    )


@dataclass(frozen=True)
class Changes:
    """Agents that take another class in sight, as most do that begin to play something else.

    agent: (m,) intp. block: (m, 2) uint16 and classes: (m, 2) uint8, before and after.
    pixels: (m,) float64, what a jump by a whole cycle would move a foot.
    """

    agent: np.ndarray
    block: np.ndarray
    classes: np.ndarray
    pixels: np.ndarray

    def of(self, mask: np.ndarray) -> "Changes":
        """Return those of the mask `mask`, (m,) bool."""
        return Changes(self.agent[mask], self.block[mask], self.classes[mask], self.pixels[mask])

    def jumps(self, phases: Phases) -> np.ndarray:
        """Return by how many pixels each change moves a foot, (m,) float64.

        Beside what the change moves with all CLASSES classes.
        """
        ahead = np.empty(self.classes.shape)
        for side in (0, 1):
            own = (self.classes[:, side] + phases.shift[self.agent]) % CLASSES
            shown = phases.classes_of(self.agent, self.block[:, side], self.classes[:, side])
            ahead[:, side] = (shown.astype(np.int16) - own + CLASSES // 2) % CLASSES
        return self.pixels * np.abs(ahead[:, 1] - ahead[:, 0]) / CLASSES

    def refined(self, phases: Phases, mask: np.ndarray) -> Phases:
        """Return `phases` with finer palettes of the agents of the mask `mask`, (m,) bool.

        Until they change they show the class that they have shown.
        """
        agent = self.agent[mask]
        classes = self.classes[mask, 0]
        shift = phases.shift.copy()
        finer = phases.finer.copy()
        shift[agent] = (phases.classes_of(agent, self.block[mask, 0], classes) - classes) % CLASSES
        finer[agent] = phases.finer[agent] + 1
        return replace(phases, shift=shift, finer=finer)
