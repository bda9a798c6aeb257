"""The overrides that change the crowd itself, in all frames: nudge, group, and hide."""

from dataclasses import replace

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.shot.overrides import HIDE, parse_agents
from ....crowd_lod.sources.changed import CrowdOverride, Overridden
from ....crowd_lod.sources.trajectory import Trajectory
from ...blender import scene_cache, stored_values

CROWD_TYPES = ("NUDGE", "GROUP")  # types of overrides that only change the crowd
# By scene: the trajectory and the inputs of the overrides at the last call, the overridden crowd,
# and sentences on overrides that are wrong.
_overridden: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)


def override_inputs(settings) -> tuple:
    """Return the inputs of the overrides that change the crowd; () without any."""
    return tuple(
        (entry.name, *marks_of(entry))
        for entry in settings.overrides
        if entry.use and changes_crowd(entry)
    )


def marks_of(entry) -> tuple:
    """Return the values of the entry that its override depends on."""
    value = {"NUDGE": tuple(entry.move), "GROUP": entry.group_name}.get(entry.type)
    return entry.type, value, entry.select_by, entry.agents.strip()


def with_overrides(scene: bpy.types.Scene, trajectory: Trajectory) -> Trajectory:
    """Return `trajectory` with the scene's overrides of it, cached by both.

    Wrong overrides are left out; see `troubles_of`.
    """
    marks = override_inputs(scene.crowd_lod)
    cached = _overridden.get(scene.session_uid)
    if cached is None or cached[0] is not trajectory or cached[1] != marks:
        cached = trajectory, marks, *_overridden_crowd(scene, trajectory)
        _overridden[scene.session_uid] = cached
    return cached[2]


def troubles_of(scene: bpy.types.Scene) -> list[str]:
    """Return a sentence for each override that the last call of `with_overrides` left out."""
    known = _overridden.get(scene.session_uid)
    return known[3] if known is not None else []


def without_overrides(trajectory: Trajectory) -> Trajectory:
    """Return the crowd without overrides; its groups are the overridden ones."""
    agents = trajectory.bare
    return agents.base if isinstance(agents, Overridden) else agents


def changes_crowd(entry) -> bool:
    """Return whether the entry changes the crowd itself."""
    return entry.type in CROWD_TYPES or (
        entry.type == HIDE and entry.all_frames and entry.select_by == "NUMBERS"
    )


def _overridden_crowd(
    scene: bpy.types.Scene, trajectory: Trajectory
) -> tuple[Trajectory, list[str]]:
    overrides: list[CrowdOverride] = []
    wrong = []
    for entry in scene.crowd_lod.overrides:
        try:
            if entry.use and changes_crowd(entry):
                overrides.append(_override_of(entry, trajectory))
        except CrowdError as error:
            wrong.append(str(error))
    try:
        return (Overridden(trajectory, overrides) if overrides else trajectory), wrong
    except CrowdError as error:  # of sources that decide on groups
        return Overridden(trajectory, [replace(override, group=None) for override in overrides]), [
            *wrong,
            str(error),
        ]


def _override_of(entry, trajectory: Trajectory) -> CrowdOverride:
    stored_values.check(entry)
    if entry.select_by != "NUMBERS":
        raise CrowdError(f"The override {entry.name} has no agents yet: press Find Agents.")
    agents = parse_agents(entry.agents, len(trajectory.start), entry.name, trajectory.ids)
    names = [group.name for group in trajectory.groups]
    people = [group.name for group in trajectory.groups if not group.slot]
    if entry.type == "GROUP" and entry.group_name not in people:
        raise CrowdError(
            f"The override {entry.name} names the character group "
            f"{entry.group_name or 'without a name'}, which is missing: "
            f"choose one of {', '.join(people)}."
        )
    return CrowdOverride(
        agents,
        move=tuple(entry.move) if entry.type == "NUDGE" else (0.0, 0.0, 0.0),
        group=names.index(entry.group_name) if entry.type == "GROUP" else None,
        hide=entry.type == HIDE,
    )
