"""What the overlay draws, as arrays: agents in their colors, camera frustum and LOD ranges."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from ...crowd_lod.culling.camera import Camera, frustum_corners
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.reasons import REASONS, reasons
from ...crowd_lod.shot.pixels import errors_of
from ..blender.colors import to_linear
from ..lods.make_lods import TINTS
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
        names=tuple(reason[:1].upper() + reason[1:] for reason in REASONS.values()),
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


# Linear RGBA.
CULLED = (0.45, 0.45, 0.45, 0.6)
HIDDEN = (0.12, 0.2, 0.28, 0.9)  # agents that scenery hides
FRUSTUM = (0.9, 0.75, 0.0, 1.0)
CULLED_SIZE = 0.6  # of a visible agent's
# points: of a larger crowd every so many-th agent shows where it is culled, in all frames the same
MOST_CULLED = 100_000
WIDTH = 0.6  # of a point, in radii of the agent's sphere
GROUPS = 256  # at most


@dataclass(frozen=True)
class Style:
    """How a crowd is drawn.

    mode: MESHES, BOXES or POINTS.
    culled: whether culled agents show, as faint points.
    turn: radians about z that turn a character to face +x.
    materials: whether meshes have the colors of their materials.
    """

    mode: str = "POINTS"
    culled: bool = True
    turn: float = 0.0
    materials: bool = False


@dataclass(frozen=True)
class Drawing:
    """One frame's instances, points and lines, in meters relative to `origin`.

    Relative positions keep float32 accurate to a millimeter, wherever in the world the shot is.

    origin: (3,) float64, world meters, the camera's position.
    agents: (m, 8) float32, the instances, sorted by draw: x, y, z of the feet, heading, phase,
        color, pitch, roll (radians); (m, 9) with their scale, where they are of several sizes.
        color is an index into `palette`.
    draws: (LOD, group, first instance, count) each, the finest LOD first.
    plays: the name of the action that each draw shows; () if all show their groups' own.
    palette: (p, 4) float32, linear.
    turn, materials: see Style.
    positions: (n, 3) float32, the points, at the centers of the agents' spheres: LOD 0 first,
        culled agents last.
    colors: (n, 4) float32, linear RGBA, of the points.
    sizes: (n,) float32, relative to the largest character's.
    diameter: meters of a point of size 1.
    lines: (m, 2, 3) float32, both ends.
    line_colors: (m, 2, 4) float32, linear RGBA.
    """

    origin: np.ndarray
    agents: np.ndarray
    draws: tuple[tuple[int, int, int, int], ...]
    palette: np.ndarray
    turn: float
    materials: bool
    positions: np.ndarray
    colors: np.ndarray
    sizes: np.ndarray
    diameter: float
    lines: np.ndarray
    line_colors: np.ndarray
    plays: tuple[str, ...] = ()


def drawing(frame: Frame, style: Style = Style(), colors: Colors | None = None) -> Drawing:
    """Return the Drawing of `frame`.

    colors: None for the colors of the LODs.
    """
    crowd = frame.crowd
    origin = frame.camera.origin
    colors = colors or by_level(frame)
    center = frame.trajectory.spheres.center
    radius = frame.trajectory.spheres.radius
    points = style.mode == "POINTS"
    visible = len(frame.buckets.order) if points else 0
    culled = _culled_agents(frame) if style.culled else np.empty(0, np.intp)
    order = np.concatenate([frame.buckets.order[:visible], culled])
    group = crowd.group[order]
    agents, draws, plays = (
        (np.empty((0, 8), np.float32), (), ()) if points else _instances(frame, colors)
    )

    positions = np.stack(
        crowd.places(center, order, origin), axis=1, dtype=np.float32, casting="same_kind"
    )
    tints = np.empty((len(order), 4), np.float32)
    tints[:visible] = colors.palette[colors.index[order[:visible]]]
    tints[visible:] = CULLED
    if frame.hidden is not None:
        tints[visible:][frame.hidden[culled]] = HIDDEN
    if colors.culled:
        tints[visible:, :3] = colors.palette[colors.index[order[visible:]], :3]

    largest = float(radius.max()) or 1.0
    sizes = (radius / largest).astype(np.float32)[group]
    sizes[visible:] *= CULLED_SIZE

    lines, line_colors = frustum_lines(frame.camera, frame.thresholds)
    return Drawing(
        origin=origin,
        agents=agents,
        draws=draws,
        palette=colors.palette,
        turn=style.turn,
        materials=style.materials,
        positions=positions,
        colors=tints,
        sizes=sizes,
        diameter=WIDTH * largest,
        lines=(lines - origin).astype(np.float32),
        line_colors=line_colors,
        plays=plays,
    )


def _culled_agents(frame: Frame) -> np.ndarray:
    """Return the culled agents that show, (m,) intp: of a large crowd every so many-th."""
    count = len(frame.crowd)
    agents = np.arange(0, count, max(ceil(count / MOST_CULLED), 1))
    return agents[frame.culled[agents]]


def _instances(frame: Frame, colors: Colors) -> tuple[np.ndarray, tuple, tuple]:
    """Return (agents, draws, plays) of a Drawing."""
    crowd = frame.crowd
    order = frame.buckets.order
    levels = frame.buckets.levels
    # a draw is a LOD of a group in an action: its number has them in this order
    draw = levels.astype(np.uint16) * np.uint16(GROUPS) + crowd.group[order]
    gaits = frame.trajectory.gaits
    actions = len(gaits.actions)
    if actions > 1:
        action = gaits.action[crowd.playing[order]].astype(np.uint32)
        draw = draw.astype(np.uint32) * np.uint32(actions) + action
    by_draw = np.argsort(draw, kind="stable")
    order = order[by_draw]
    numbers, first, count = np.unique(draw[by_draw], return_index=True, return_counts=True)

    agents = np.zeros((len(order), 8), np.float32)
    agents[:, 0], agents[:, 1], agents[:, 2] = crowd.places(None, order, frame.camera.origin)
    agents[:, 3] = crowd.heading[order]
    agents[:, 4] = frame.phase_of(order)
    agents[:, 5] = colors.index[order]
    leaning = frame.trajectory.tilt(crowd, order)
    if leaning is not None:
        agents[:, 6], agents[:, 7] = leaning
    scale = frame.trajectory.scale(crowd, order)
    if scale is not None:
        agents = np.column_stack([agents, scale])
    numbers, actions_drawn = np.divmod(numbers, actions)
    draws = zip(*np.divmod(numbers, GROUPS), first, count, strict=True)
    plays = tuple(gaits.actions[k] for k in actions_drawn) if any(gaits.actions) else ()
    return agents, tuple(tuple(int(value) for value in each) for each in draws), plays


def frustum_lines(camera: Camera, thresholds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (ends, colors) of the lines of the camera's frustum and LOD ranges.

    The lines are the frustum's edges, and a rectangle where each LOD begins, in its tint. Where
    groups have other thresholds, a LOD has several rectangles. A panoramic camera has no lines.
    Returns ends (m, 2, 3) float64, world meters, and colors (m, 2, 4) float32, linear RGBA.

    thresholds: (G, n - 1) meters, see crowd_lod.levels.assignment.threshold_distances.
    """
    if camera.kind == "PANO":
        return np.empty((0, 2, 3)), np.empty((0, 2, 4), np.float32)
    near = frustum_corners(camera, camera.near)
    far = frustum_corners(camera, camera.far)
    ends = [np.stack([near, far], axis=1), _ring(near), _ring(far)]
    colors = [FRUSTUM] * 3
    for level, distances in enumerate(thresholds.T, start=1):
        for distance in np.unique(distances[(distances > camera.near) & (distances <= camera.far)]):
            ends.append(_ring(frustum_corners(camera, distance)))
            colors.append((*TINTS[level], 1.0))
    each = np.array(colors, np.float32)[:, None, None]
    return np.concatenate(ends), np.broadcast_to(each, (len(ends), 4, 2, 4)).reshape(-1, 2, 4)


def _ring(corners: np.ndarray) -> np.ndarray:
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
