"""The colors that the overlay gives to agents."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.planning.frame import Frame
from ...crowd_lod.planning.reasons import reasons
from ..blender.color_space import linear
from ..lod_meshes.make_lods import TINTS
from .skinned_characters import Character

# the last reasons; LODs have no more tints
PURPLE, BROWN = (0.45, 0.2, 0.75), (0.25, 0.12, 0.05)


@dataclass(frozen=True)
class Colors:
    """The agents' colors, as indices into a palette.

    index: (n,) uint8, each agent's color in `palette`.
    palette: (p, 4) float32, linear RGBA.
    culled: whether culled agents show their color too; if not, their index has no meaning.
    """

    index: np.ndarray
    palette: np.ndarray
    culled: bool = False


def by_level(frame: Frame) -> Colors:
    """Color agents by LOD."""
    index = np.zeros(len(frame.crowd), np.uint8)  # frame.levels would be measured for all agents
    index[frame.buckets.order] = frame.buckets.levels
    return Colors(index, _opaque(TINTS))


def by_state(frame: Frame) -> Colors:
    """Color agents by state, in the state machine's colors."""
    return Colors(frame.crowd.state, _opaque(linear(frame.trajectory.machine.state_colors / 255)))


def by_group(frame: Frame) -> Colors:
    """Color agents by character group; colors repeat after the last of TINTS."""
    return Colors(frame.crowd.group % np.uint8(len(TINTS)), _opaque(TINTS))


def by_reason(frame: Frame) -> Colors:
    """Color agents by the reason why they are culled or do not have the finest LOD.

    The reasons are those of crowd_lod.planning.reasons.REASONS.
    """
    return Colors(reasons(frame), _opaque([*TINTS, PURPLE, BROWN]), culled=True)


def by_material(frame: Frame, characters: Sequence[Character]) -> Colors:
    """Color agents with the mean color of their group's materials."""
    return Colors(frame.crowd.group, _opaque([character.color for character in characters]))


def _opaque(rgb) -> np.ndarray:
    rgb = np.array(rgb, np.float32)
    return np.concatenate([rgb, np.ones_like(rgb[:, :1])], axis=1)
