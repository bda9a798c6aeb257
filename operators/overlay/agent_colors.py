"""The colors that the overlay gives to agents."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.reasons import REASONS, reasons
from ...crowd_lod.shot.frame_errors import errors_of
from ..blender.color_space import to_linear
from ..lod_meshes.make_lods import TINTS
from .skinned_characters import SkinnedCharacter

# the last reasons; LODs have no more tints
BROWN = (0.25, 0.12, 0.05)
SLATE = (0.12, 0.2, 0.28)
BLACK = (0.01, 0.01, 0.01)
ERRORS = 0.25, 0.5, 1.0, 2.0  # pixels, where the next color begins
ERROR_TINTS = (  # from green to red
    (0.02, 0.35, 0.05),
    (0.3, 0.6, 0.05),
    (0.8, 0.6, 0.02),
    (0.8, 0.2, 0.02),
    (0.6, 0.0, 0.02),
)


@dataclass(frozen=True)
class Colors:
    """The agents' colors, as indices into a palette.

    index: (n,) unsigned, each agent's color in `palette`.
    palette: (p, 4) float32, linear RGBA.
    culled: whether culled agents show their color too; if not, their index has no meaning.
    names: what the colors mean, in the palette's order, which starts again where there are more
        names than colors; () if there is nothing to tell.
    by_lod: whether the colors are those of the LODs.
    """

    index: np.ndarray
    palette: np.ndarray
    culled: bool = False
    names: tuple[str, ...] = ()
    by_lod: bool = False

    def of_name(self, k: int) -> tuple[float, float, float]:
        """Return the linear color of names[k]."""
        red, green, blue, _ = self.palette[k % len(self.palette)].tolist()
        return red, green, blue

    def of_agent(self, agent: int, visible: bool) -> tuple[float, float, float] | None:
        """Return the linear color of an agent; None if it is culled and has none."""
        return self.of_name(int(self.index[agent])) if visible or self.culled else None


def by_level(frame: Frame) -> Colors:
    """Color agents by LOD."""
    index = np.zeros(len(frame.crowd), np.uint8)  # frame.levels would be measured for all agents
    index[frame.buckets.order] = frame.buckets.levels
    return Colors(
        index,
        _opaque(TINTS),
        names=tuple(f"LOD {k}" for k in range(len(frame.buckets.counts))),
        by_lod=True,
    )


def by_state(frame: Frame) -> Colors:
    """Color agents by state, in the colors of their states."""
    states = frame.trajectory.states
    return Colors(frame.crowd.state, _opaque(to_linear(states.colors / 255)), names=states.names)


def by_group(frame: Frame) -> Colors:
    """Color agents by character group; colors repeat after the last of TINTS."""
    names = tuple(group.name for group in frame.trajectory.groups)
    return Colors(frame.crowd.group % np.uint8(len(TINTS)), _opaque(TINTS), names=names)


def by_reason(frame: Frame) -> Colors:
    """Color agents by the reason why they are culled or do not have the finest LOD.

    The reasons are those of crowd_lod.frame.reasons.REASONS.
    """
    return Colors(
        reasons(frame),
        _opaque([*TINTS, BROWN, SLATE, BLACK]),
        culled=True,
        names=tuple(reason[:1].upper() + reason[1:] for reason in REASONS),
    )


def by_error(frame: Frame) -> Colors:
    """Color agents by the pixels that their LOD deviates at most; by LOD if that is not known."""
    errors = errors_of(frame)
    if errors is None:
        return by_level(frame)
    index = np.zeros(len(frame.crowd), np.uint8)
    index[frame.buckets.order] = np.searchsorted(ERRORS, errors)
    names = [f"Up to {limit:g} px off" for limit in ERRORS]
    return Colors(index, _opaque(ERROR_TINTS), names=(*names, f"Over {ERRORS[-1]:g} px off"))


def by_material(frame: Frame, characters: Sequence[SkinnedCharacter]) -> Colors:
    """Color agents with the mean color of their group's materials, or by its ramp of looks."""
    ramps = [
        character.color[None] if character.ramp is None else character.ramp
        for character in characters
    ]
    sizes = np.array([len(ramp) for ramp in ramps])
    index = frame.crowd.group
    if sizes.max() > 1:
        steps = (frame.trajectory.looks * sizes[index]).astype(np.intp)
        index = ((np.cumsum(sizes) - sizes)[index] + steps).astype(np.uint16)
    return Colors(index, _opaque(np.concatenate(ramps)))


def _opaque(rgb) -> np.ndarray:
    rgb = np.array(rgb, np.float32)
    return np.concatenate([rgb, np.ones_like(rgb[:, :1])], axis=1)
