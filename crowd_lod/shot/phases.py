"""Phase classes of a shot: few of them, chosen so that few close neighbors walk in step.

An agent's source gives it one of CLASSES classes (animation/phase_classes.py). The shot's plan adds
a shift to that class, and takes the nearest class of a palette. So the phase still follows from the
crowd at a time alone, at sub-frames and after changes of pace, too.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..animation.phase_classes import Gaits, Roles, first_blocks
from ..crowd.agents import CLASSES, Crowd
from .survey import CULLED, Survey


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


def recast(survey: Survey, phases: Phases) -> Survey:
    """Return `survey` with the characters that agents show by `phases`."""
    assert survey.roles is not None
    character = np.empty_like(survey.character)
    for cells, new_characters, rows, kind in survey.cells.tables(
        character, survey.character, survey.kind
    ):
        # what an agent shows follows from its character, which few change from frame to frame
        is_new = np.ones(rows.shape, bool)
        np.not_equal(rows[1:], rows[:-1], out=is_new[1:])
        f, column = np.nonzero(is_new)
        own = rows[f, column]
        new_characters[f, column] = _recast(survey.roles, phases, cells.agents[column], own)
        for g in range(1, len(rows)):
            np.copyto(new_characters[g], new_characters[g - 1], where=~is_new[g])
        new_characters[kind == CULLED] = 0
    return replace(survey, character=character)


def _recast(roles: Roles, phases: Phases, agents: np.ndarray, character: np.ndarray) -> np.ndarray:
    """Return the characters (m,) that `agents` (m,) show by `phases`, of what they show without."""
    block = roles.block[character]
    (rigged,) = np.nonzero(block >= 0)
    classes = roles.phase_class[character[rigged]]
    shown = phases.classes_of(agents[rigged], block[rigged], classes)
    recast = character.copy()
    recast[rigged] += (shown.astype(np.int32) - classes).astype(recast.dtype)
    return recast
