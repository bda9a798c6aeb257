"""The colours that the overlay gives to agents."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.planning.frame import Frame
from ...crowd_lod.planning.reasons import reasons
from ..blender.color_space import linear
from ..lod_meshes.make_lods import TINTS
from .skinned_characters import Character


@dataclass(frozen=True)
class Colours:
    """index: (n,) uint8, each agent's colour in palette (p, 4) float32, linear RGBA; of culled agents only where `culled`, then
    they show theirs, too."""

    index: np.ndarray
    palette: np.ndarray
    culled: bool = False


def by_level(frame: Frame) -> Colours:
    """By LOD."""
    index = np.zeros(len(frame.crowd), np.uint8)  # frame.levels would be measured for all agents
    index[frame.buckets.order] = frame.buckets.levels
    return Colours(index, _opaque(TINTS))


def by_state(frame: Frame) -> Colours:
    """As the state machine says."""
    return Colours(frame.crowd.state, _opaque(linear(frame.trajectory.machine.state_colours / 255)))


def by_group(frame: Frame) -> Colours:
    """By character group; with more groups than tints they begin again."""
    return Colours(frame.crowd.group % np.uint8(len(TINTS)), _opaque(TINTS))


def by_reason(frame: Frame) -> Colours:
    """By the reason, of reasons.REASONS, why an agent is culled or has not the finest LOD."""
    return Colours(reasons(frame), _opaque(TINTS), culled=True)


def by_material(frame: Frame, characters: Sequence[Character]) -> Colours:
    """In the mean colour of each group's materials."""
    return Colours(frame.crowd.group, _opaque([character.colour for character in characters]))


def _opaque(rgb) -> np.ndarray:
    rgb = np.array(rgb, np.float32)
    return np.concatenate([rgb, np.ones_like(rgb[:, :1])], axis=1)
