"""From the scene's settings to the core's crowd: groups, map, trajectory, LODs."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Cast
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.assignment import Bias, LevelPolicy
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..blender.named_actions import own_performance
from .characters.characters import GROUP, characters_of, check_measured
from .characters.rig_needs import POSES, Characters, leads, refusal
from .characters.stored_groups import count_of, groups_of, lead_of
from .machine.scene_world import bias_of
from .sources import crowd_sources


@dataclass(frozen=True, eq=False)
class SceneCrowd:
    """The crowd of a scene and its choice of LODs, as a press finds them.

    It is read once a press, a command, a frame of the live build or a drawing of the overlay, and
    handed on. It is read again after what changes groups: Populate and Make LOD Meshes.

    bias: the map of detail.
    """

    scene: bpy.types.Scene
    trajectory: Trajectory
    policy: LevelPolicy
    bias: Bias | None = None

    @property
    def settings(self) -> bpy.types.PropertyGroup:
        """The settings of the scene."""
        return self.scene.crowd_lod

    @cached_property
    def characters(self) -> Characters:
        """The character groups: see characters_of."""
        return characters_of(self.scene)

    @cached_property
    def cast(self) -> Cast:
        """The Cast that a build makes of the characters.

        A group that plays nothing but an action of one frame has one pose. One whose data say that
        no rig can show it has POSES in each action; for every other group, rigs are assumed to be
        able to show its motion. CrowdError if the characters are others than the trajectory's, or
        a part would leave who wears it.
        """
        groups = self.trajectory.groups
        check_measured(self.characters, groups)
        posed = np.array([self._poses(objects) for _, objects, _ in self.characters], np.intp)
        return Cast(posed[leads(self.characters, groups)])

    def _poses(self, objects: list[bpy.types.Object]) -> int:
        """Return the poses that a character has in each of its actions; 0 if rigs may show it."""
        if own_performance(objects).still and not any(self.trajectory.gaits.actions):
            return 1
        return POSES if refusal(objects) else 0

    @property
    def groups_in_meters(self) -> list[Group]:
        """The trajectory's groups, with their lengths in meters."""
        meters = scene_data.meters(self.scene)
        return [group.scaled(meters) for group in self.trajectory.groups]

    def at_present_frame(self) -> "SceneCrowd":
        """Return the same agents with the LODs of the scene's frame: settings may be animated."""
        return replace(self, policy=policy_of(self.settings), bias=bias_of(self.settings))


def read_crowd(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph | None = None,
    groups: tuple[Group, ...] | None = None,
) -> SceneCrowd:
    """Read the crowd of `scene`; groups, depsgraph: see trajectory_of.

    CrowdError if the crowd is not populated or a setting is bad.
    """
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene, groups, depsgraph)
    return SceneCrowd(scene, trajectory, policy_of(settings), bias_of(settings))


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


def check_levels(crowd: SceneCrowd) -> None:
    """Raise CrowdError if LOD meshes do not fit the settings."""
    scene = crowd.scene
    settings = crowd.settings
    if settings.levels is None:
        raise CrowdError(f"The scene {scene.name} has no LOD meshes: press Make LOD Meshes.")
    levels = settings.levels.children
    count = crowd.policy.count
    groups = len(levels[0].children) if levels else 0
    if len(levels) < count or groups != len(settings.groups):
        raise CrowdError(
            f"The LOD meshes of {scene.name} ({len(levels)} LODs of {groups} character groups) do "
            f"not fit the settings "
            f"({count} of {len(settings.groups)}): press Make LOD Meshes and Build again."
        )
    for level in levels[:count]:
        for g, group in enumerate(settings.groups):
            home_of(level, g, group.name)


def policy_of(settings, choice: str = "") -> LevelPolicy:
    """Return the LOD policy of the settings.

    By tolerance, a LOD begins where its deviation shows that many pixels.

    choice: BY_DISTANCE or BY_TOLERANCE in place of the settings' own.
    """
    tolerant = (choice or settings.choice) == "BY_TOLERANCE"
    group_thresholds = [
        _thresholds(group, settings) if group.use_custom_thresholds and not tolerant else ()
        for group in map(lead_of, settings.groups)
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
    settings = scene.crowd_lod
    groups = groups or groups_of(settings)
    if not groups or not len(settings.crowds):
        raise CrowdError(
            f"The crowd of the scene {scene.name} is not populated: press Populate in the Crowd "
            f"panel."
        )
    return crowd_sources.combine_crowds(scene, groups, depsgraph)
