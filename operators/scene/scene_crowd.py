"""From the scene's settings to the core's crowd: groups, map, trajectory, plan."""

from collections.abc import Sequence
from contextlib import suppress

import bpy

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.shadows import Surroundings, surround
from ...crowd_lod.levels.assignment import LevelPolicy
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..blender.cameras import read_cameras, read_shutter
from ..characters.characters import GROUP, characters_of
from ..characters.stored_groups import count_of, groups_of, lead_of
from ..machine.scene_world import bias_of
from ..sources import crowd_sources
from .shot_reference import use_of


def set_down(entry: bpy.types.PropertyGroup) -> None:
    """Update a group after on_ground changed: move its sphere and LODs to its feet."""
    entry.center += -entry.lowest if entry.on_ground else entry.lowest
    for part in entry.id_data.crowd_lod.groups:
        if part.variant_of == entry.name and part.on_ground != entry.on_ground:
            part.on_ground = entry.on_ground
    if entry.lowest:
        with suppress(CrowdError):  # there are no characters; nothing shows LODs then
            place_levels(entry.id_data)


def place_levels(scene: bpy.types.Scene) -> None:
    """Place the LODs of each group of `scene` at its feet."""
    settings = scene.crowd_lod
    levels = (
        settings.levels.children
        if settings.levels is not None and not scene_data.is_shared(scene, "levels")
        else ()
    )
    origins = {name: origin for name, _, origin in characters_of(scene)} if levels else {}
    feet = {group.name: group.feet for group in groups_of(settings)}
    for home in (home for level in levels for home in level.children):
        name = home.get(GROUP)
        if name in origins and name in feet:
            home.instance_offset = (*origins[name][:2], origins[name][2] + feet[name])


def home_of(level: bpy.types.Collection, g: int, name: str) -> bpy.types.Collection:
    """Return the collection of the group `name` in the collection `level` of one LOD.

    CrowdError if it has no LOD meshes.

    g: index of the group.
    """
    home = level.children[g] if g < len(level.children) else None
    if home is None or not home.objects or home.get(GROUP, name) != name:
        raise CrowdError(
            f"The character group {name} has no LOD meshes in {level.name}: press Make LOD Meshes "
            f"again."
        )
    return home


def policy_of(settings, choice: str = "") -> LevelPolicy:
    """Return the LOD policy of the settings.

    By tolerance, a LOD begins where its deviation shows that many pixels.

    choice: BY_RATIO or BY_TOLERANCE in place of the settings' own.
    """
    tolerant = (choice or settings.choice) == "BY_TOLERANCE"
    leads = [lead_of(group) for group in settings.groups]
    group_thresholds = [
        _thresholds(group, settings) if group.own_thresholds and not tolerant else ()
        for group in leads
    ]
    return LevelPolicy(
        thresholds=(0.0,) * (count_of(settings, choice) - 1)
        if tolerant
        else _thresholds(settings, settings),
        group_thresholds=tuple(group_thresholds) if any(group_thresholds) else (),
        tolerance=round(max(settings.tolerance, settings.memory_tolerance), 6)
        if tolerant
        else None,
        finest=tuple(group.finest for group in settings.groups)
        if tolerant and settings.memory_tolerance
        else (),
        margin=settings.margin if settings.margin_kind == "FIXED" else None,
        shading=tolerant and settings.shading_counts,
    )


def _thresholds(owner, settings) -> tuple[float, ...]:
    """Return the thresholds of `owner`, settings or group."""
    return tuple(round(t, 6) for t in owner.thresholds[: settings.level_count - 1])


def trajectory_of(
    scene: bpy.types.Scene,
    groups: tuple[Group, ...] | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> Trajectory:
    """Return the scene's crowd over time, cached while its inputs stay the same.

    CrowdError if the crowd is not populated or a setting is bad.

    groups: measured groups in place of those that the settings hold.
    depsgraph: where objects are evaluated whose points are agents; the view layer's own if None.
    """
    groups = groups or groups_of(scene.crowd_lod)
    if not groups:
        raise CrowdError(
            f"The crowd of the scene {scene.name} is not populated: press Populate in the Crowd "
            f"panel."
        )
    return crowd_sources.combine_crowds(scene, groups, depsgraph)


def frame_of(  # noqa: PLR0913 - most are at hand, and read if not
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    time: float | None = None,
    camera: Camera | Sequence[Camera] | None = None,
    trajectory: Trajectory | None = None,
    around: Surroundings | None = None,
    shutter: Sequence[tuple[float, Sequence[Camera]]] | None = None,
) -> Frame:
    """Return the plan of the crowd at `time`, with the LODs of the scene's shot plan if it has one.

    time: frames of the animation; the scene's own if None (see scene_data.time_of).
    camera: one camera, or the eyes; the active ones as `depsgraph` has them if None.
    trajectory: the scene's, if it is at hand.
    around: lights and mirrors; with them, unseen agents that still matter are found, too.
    shutter: with motion blur, times and cameras of the open shutter; read from the scene if None.
    """
    if time is None:
        time = scene_data.time_of(scene)
    trajectory = trajectory or trajectory_of(scene, depsgraph=depsgraph)
    settings = scene.crowd_lod
    eyes = camera or read_cameras(scene, depsgraph)
    shutter = read_shutter(scene, time) if shutter is None else shutter
    bias = bias_of(settings)
    use = use_of(
        settings,
        trajectory,
        policy_of(settings),
        bias,
        time,
        (eyes,) if isinstance(eyes, Camera) else eyes,
    )
    frame = plan(trajectory, eyes, policy_of(settings), time, shutter, bias)
    # hidden agents cast no shadow, so exceptions come last
    return use.applied(frame if around is None else surround(frame, around))
