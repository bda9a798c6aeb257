"""Which agents of a shot are seen close to each other, and who changes what it plays in sight."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd.agents import CLASSES, Group
from .phases import Phases
from .survey import Survey

# A foot stands for more than half of a walk's cycle and swings forward in the rest: per cycle it
# moves beside the body at this multiple of the stride at most.
SWING = 2.3


@dataclass(frozen=True)
class Meetings:
    """Pairs of agents that are seen close to each other while both play the same.

    pair: (m, 2) int32, agents.
    block: (m, 2) uint16, what each of them plays (phase_classes.Roles).
    classes: (m, 2) uint8, the classes of their sources then.
    frames: (m,) int64, in how many frames of the survey that were looked at.
    weight: (m,) float64, by nearness and size in pixels, summed over these frames.
    """

    pair: np.ndarray
    block: np.ndarray
    classes: np.ndarray
    frames: np.ndarray
    weight: np.ndarray

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


def meetings_of(survey: Survey) -> Meetings:
    """Return the meetings that `survey` has seen."""
    assert survey.roles is not None
    pair = survey.encounters.pair
    character = survey.encounters.characters
    weight = survey.encounters.weight
    block = survey.roles.block[character].astype(np.uint16)
    classes = survey.roles.phase_class[character]
    key = np.column_stack((pair, block, classes))
    order = np.lexsort(key.T)
    key = key[order]
    begins = np.append(True, (key[1:] != key[:-1]).any(axis=1))[: len(key)]
    (first,) = np.nonzero(begins)
    if not len(first):
        return Meetings(pair, block, classes, np.empty(0, np.int64), weight)
    longest = order[first]
    return Meetings(
        pair[longest],
        block[longest],
        classes[longest],
        np.diff(np.append(first, len(key))),
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


def strides_of(groups: Sequence[Group], gaits: Gaits) -> np.ndarray:
    """Return the stride of what each block plays, (B,) float64 meters; 0 of what is not a walk."""
    return np.array(
        [
            group.action(gaits.actions[action]).stride
            for group, played in zip(groups, gaits.plays, strict=True)
            for action, _ in played
        ]
    )


def changes_of(survey: Survey, strides: np.ndarray) -> Changes:
    """Return the changes of `survey` from one walk to another; strides: of strides_of.

    What is no walk is in no step that a change could break.
    """
    assert survey.roles is not None
    of_block = survey.roles.block
    walks = np.append(strides, 0.0)
    parts = []
    for block, character, scale in survey.cells.tables(survey.character, survey.scale):
        is_other = survey.joined(block)
        is_other[1:] &= character[1:] != character[:-1]
        f, column = np.nonzero(is_other)
        pair = np.column_stack((character[f - 1, column], character[f, column]))
        stride = walks[of_block[pair]]
        (walking,) = np.nonzero((stride > 0).all(axis=1))
        pair = pair[walking]
        pixels = scale[f, column].astype(np.float64)[walking]
        parts.append(
            (
                block.agents[column[walking]],
                of_block[pair],
                survey.roles.phase_class[pair],
                SWING * stride[walking, 1] * pixels,
            )
        )
    if not parts:
        none = np.empty((0, 2), np.intp)
        return Changes(none[:, 0], none, none.astype(np.uint8), np.empty(0))
    return Changes(*(np.concatenate(column) for column in zip(*parts, strict=True)))
