"""The exceptions that change the crowd itself, in all frames: nudge, group, and hide."""

from dataclasses import replace

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.shot.exceptions import HIDE, parse_agents
from ...crowd_lod.sources.edited import Edit, Edited
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_cache, stored_values

EDITS = ("NUDGE", "GROUP")  # kinds of exceptions that only edit
# By scene: the trajectory and the inputs of the edits at the last call, the edited crowd, and
# sentences on edits that are wrong.
_edited: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)


def edit_inputs(settings) -> tuple:
    """Return the inputs of the settings' edits; () without any."""
    return tuple(
        (entry.name, *marks_of(entry))
        for entry in settings.exceptions
        if entry.use and edits(entry)
    )


def marks_of(entry) -> tuple:
    """Return the values of the entry that its edit depends on."""
    value = {"NUDGE": tuple(entry.move), "GROUP": entry.group_name}.get(entry.kind)
    return entry.kind, value, entry.chosen_by, entry.agents.strip()


def with_edits(scene: bpy.types.Scene, trajectory: Trajectory) -> Trajectory:
    """Return `trajectory` with the edits of the scene's exceptions, cached by both.

    Wrong edits are left out; see `troubles_of`.
    """
    marks = edit_inputs(scene.crowd_lod)
    cached = _edited.get(scene.session_uid)
    if cached is None or cached[0] is not trajectory or cached[1] != marks:
        cached = _edited[scene.session_uid] = trajectory, marks, *_edited_crowd(scene, trajectory)
    return cached[2]


def troubles_of(scene: bpy.types.Scene) -> list[str]:
    """Return a sentence for each edit that the last call of `with_edits` left out."""
    known = _edited.get(scene.session_uid)
    return known[3] if known is not None else []


def without_edits(trajectory: Trajectory) -> Trajectory:
    """Return the crowd without edits; its groups are the edited ones."""
    agents = trajectory.bare
    return agents.base if isinstance(agents, Edited) else agents


def edits(entry) -> bool:
    """Return whether the entry changes the crowd itself."""
    return entry.kind in EDITS or (
        entry.kind == HIDE and entry.all_frames and entry.chosen_by == "NUMBERS"
    )


def _edited_crowd(scene: bpy.types.Scene, trajectory: Trajectory) -> tuple[Trajectory, list[str]]:
    edit_list: list[Edit] = []
    wrong = []
    for entry in scene.crowd_lod.exceptions:
        try:
            if entry.use and edits(entry):
                edit_list.append(_edit(entry, trajectory))
        except CrowdError as error:
            wrong.append(str(error))
    try:
        return (Edited(trajectory, edit_list) if edit_list else trajectory), wrong
    except CrowdError as error:  # of sources that decide on groups
        return Edited(trajectory, [replace(edit, group=None) for edit in edit_list]), [
            *wrong,
            str(error),
        ]


def _edit(entry, trajectory: Trajectory) -> Edit:
    stored_values.check(entry)
    if entry.chosen_by != "NUMBERS":
        raise CrowdError(
            f"The override {entry.name} does not know its agents yet: press Find Agents."
        )
    agents = parse_agents(entry.agents, len(trajectory.start), entry.name, trajectory.ids)
    names = [group.name for group in trajectory.groups]
    people = [group.name for group in trajectory.groups if not group.slot]
    if entry.kind == "GROUP" and entry.group_name not in people:
        raise CrowdError(
            f"The override {entry.name} asks for the character group "
            f"{entry.group_name or 'of no name'}, and there is none: "
            f"choose one of {', '.join(people)}."
        )
    return Edit(
        agents,
        move=tuple(entry.move) if entry.kind == "NUDGE" else (0.0, 0.0, 0.0),
        group=names.index(entry.group_name) if entry.kind == "GROUP" else None,
        hide=entry.kind == HIDE,
    )
