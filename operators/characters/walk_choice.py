"""Which of its file's actions a character plays: the one that walks by its name or by its feet."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import finished
from ..blender import scene_data
from ..blender.animation import armatures_of
from ..blender.named_actions import performance_of
from ..machine.scene_world import machine_of
from .action_fits import Fit, fit_of, other_actions, take, walk_of
from .bone_motion import record

FITS = 1.5  # factor between the speeds of feet and of agents within which an action walks
BETTER = 4.0  # the same, where the rig would glide: a run in slow motion is better
STANDS = 0.1  # of the agents' speed: feet that walk slower stand
NEAR = 0.05  # of the bones' height: a bone that is so near to the ground stands on it
STILL = 0.001  # of the bones' height: a bone that moves less than that stays where it is
LANDED = 0.25  # of the poses: in so many at least a foot is on the ground, of a run as well
MOST_POSES = 48  # of an action that are looked at
USUAL = 1.25  # meters a second, of agents whose speed is not known


@dataclass(frozen=True)
class Walk:
    """An action by which a rig walks, in place of the one that it plays.

    reason: why it is taken, in words that follow its name; figures: the speeds that speak for it.
    """

    fit: Fit
    reason: str
    figures: str


def take_walks(scene: bpy.types.Scene, items: Sequence[bpy.types.Object]) -> Iterator[str]:
    """Let the rigs among the items play the walk of their file; yield a sentence on each."""
    for rig in armatures_of(items):
        walk = walk_among(scene, rig, items)
        if walk is None:
            continue
        before = rig.animation_data.action
        action = take(rig, walk.fit)
        yield (
            f"{rig.name} plays {action.name} of its file's actions{walk.reason}, in place of "
            f"{before.name}{walk.figures}."
        )


def walk_among(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object]
) -> Walk | None:
    """Return the walk among the rig's own actions, by its name or else by its feet.

    None if there is none, or the rig walks by what it plays.

    items: the character's objects.
    """
    others = other_actions(rig)
    if not others:
        return None
    before = rig.animation_data.action
    fit = walk_of(rig)
    reason = ", a walk by its name"
    speeds = feet_speeds(rig, items, [before, fit.action] if fit else [before])
    if fit is None:
        reason = ", whose feet fit the speed best"
        if before in speeds and _walks_at(scene, speeds[before]):
            return None
        speeds |= feet_speeds(rig, items, others)
        best = min(speeds, key=lambda action: _misfit(scene, speeds[action]), default=before)
        stands = speeds.get(before, 0.0) < STANDS * _speed_of(scene)
        if best != before and _walks_at(scene, speeds[best], BETTER if stands else FITS):
            fit = fit_of(rig, best, [])
    if fit is None:
        return None
    figures = ""
    if before in speeds and fit.action in speeds:
        figures = (
            f" (its feet walk at {speeds[fit.action]:.2f} m/s, those of {before.name} at "
            f"{speeds[before]:.2f} m/s, and agents at {_speed_of(scene):.2f} m/s)"
        )
    return Walk(fit, reason, figures)


def feet_speeds(
    rig: bpy.types.Object,
    items: Sequence[bpy.types.Object],
    actions: Sequence[bpy.types.Action],
) -> dict[bpy.types.Action, float]:
    """Return how fast the feet walk in those of the rig's actions that it can play, m/s.

    It is the way of the lowest bone while it is on the ground, and the root's motion taken out.

    items: the character's objects, the rig among them.
    """
    scene = bpy.context.scene
    fps = scene_data.frame_rate(scene)
    speeds = {}
    for action in actions:
        try:
            performance = performance_of(rig.name, list(items), [action.name]).only(action.name)
        except CrowdError:  # a pose, or of another rig
            continue
        ((first, last),) = performance.spans
        if first == last:
            continue
        times = np.linspace(first, last, min(int(last - first) + 2, MOST_POSES))
        bones, _ = finished(record({item: item for item in items}, times, performance))
        if rig.name in bones and bones[rig.name].rest:
            step = walked_by(bones[rig.name].heads)
            speeds[action] = step * scene_data.meters(scene) * fps / (times[1] - times[0])
    return speeds


def walked_by(heads: np.ndarray) -> float:
    """Return the meters that the lowest bone walks from one pose to the next while it stands.

    heads: (poses, bones, 3) float64 meters.
    """
    moving = np.ptp(heads, axis=0).max(axis=1) > STILL * np.ptp(heads[:, :, 2])
    if not moving.any():
        return 0.0
    heads = heads[:, moving]  # a root bone on the ground is no foot
    heights = heads[:, :, 2]
    ground = np.quantile(heights.min(axis=1), LANDED) + NEAR * np.ptp(heights)
    lowest = heights.argmin(axis=1)[:-1]
    poses = np.arange(len(lowest))
    stands = (heights[poses, lowest] <= ground) & (heights[poses + 1, lowest] <= ground)
    steps = heads[poses + 1, lowest, :2] - heads[poses, lowest, :2]
    return float(np.linalg.norm(np.median(steps[stands], axis=0))) if stands.any() else 0.0


def _speed_of(scene: bpy.types.Scene) -> float:
    """Return the median speed of the states in which the scene's agents walk, m/s."""
    settings = scene.crowd_lod
    try:
        machine = machine_of(settings) if settings.source == "MACHINE" else None
    except CrowdError:  # told at Populate
        machine = None
    speeds = np.hypot(*machine.velocity.T).ravel() if machine else np.empty(0)
    walking = speeds[speeds > 0] * scene_data.meters(scene)
    return float(np.median(walking)) if len(walking) else USUAL


def _walks_at(scene: bpy.types.Scene, speed: float, factor: float = FITS) -> bool:
    """Return whether feet of this speed fit that of agents to within the factor."""
    return _misfit(scene, speed) <= np.log(factor)


def _misfit(scene: bpy.types.Scene, speed: float) -> float:
    """Return by how much the feet's speed differs from that of agents, as a logarithm."""
    return abs(float(np.log(max(speed, 1e-6) / _speed_of(scene))))
