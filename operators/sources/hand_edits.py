"""The exceptions that change the crowd itself, in all frames: nudge, turn, group, and hide."""

from dataclasses import replace

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.shot.exceptions import HIDE, parse_agents
from ...crowd_lod.sources.edited import Edit, Edited
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_cache, stored_values

EDITS = ("NUDGE", "TURN", "GROUP")  # kinds of exceptions that only edit
# Of each scene the trajectory and the edits that were asked last, and (the edited crowd, what is
# wrong).
_edited: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)


def asked(settings) -> tuple:
    """Return what the edits of the settings follow from; () without any."""
    return tuple(
        (entry.name, *marks_of(entry))
        for entry in settings.exceptions
        if entry.use and edits(entry)
    )


def marks_of(entry) -> tuple:
    """Return what changes when the entry would edit anything else."""
    value = {"NUDGE": tuple(entry.move), "TURN": entry.turn, "GROUP": entry.group_name}.get(
        entry.kind
    )
    return entry.kind, value, entry.chosen_by, entry.agents.strip()


def with_edits(scene: bpy.types.Scene, trajectory: Trajectory) -> Trajectory:
    """Return `trajectory` with the edits of the scene's exceptions; cached while both stay the
    same.

    Those that are wrong are left out; see `troubles_of`.
    """
    marks = asked(scene.crowd_lod)
    known = _edited.get(scene.session_uid)
    if known is None or known[0] is not trajectory or known[1] != marks:
        known = _edited[scene.session_uid] = trajectory, marks, *_made(scene, trajectory)
    return known[2]


def troubles_of(scene: bpy.types.Scene) -> list[str]:
    """Return a sentence for each edit that was left out when the crowd was asked for last."""
    known = _edited.get(scene.session_uid)
    return known[3] if known is not None else []


def unedited(trajectory: Trajectory) -> Trajectory:
    """Return the crowd as it is without edits, but for its groups."""
    return trajectory.own if isinstance(trajectory, Edited) else trajectory


def edits(entry) -> bool:
    """Return whether the entry changes the crowd itself."""
    return entry.kind in EDITS or (
        entry.kind == HIDE and entry.all_frames and entry.chosen_by == "NUMBERS"
    )


def _made(scene: bpy.types.Scene, trajectory: Trajectory) -> tuple[Trajectory, list[str]]:
    found: list[Edit] = []
    wrong = []
    for entry in scene.crowd_lod.exceptions:
        try:
            if entry.use and edits(entry):
                found.append(_edit(entry, trajectory))
        except CrowdError as error:
            wrong.append(str(error))
    try:
        return (Edited(trajectory, found) if found else trajectory), wrong
    except CrowdError as error:  # of sources that decide on groups
        return Edited(trajectory, [replace(edit, group=None) for edit in found]), [
            *wrong,
            str(error),
        ]


def _edit(entry, trajectory: Trajectory) -> Edit:
    stored_values.check(entry)
    if entry.chosen_by != "NUMBERS":
        raise CrowdError(
            f"The exception {entry.name} does not know its agents yet: press Find Agents."
        )
    agents = parse_agents(entry.agents, len(trajectory.start), entry.name, trajectory.ids)
    names = [group.name for group in trajectory.groups]
    if entry.kind == "GROUP" and entry.group_name not in names:
        raise CrowdError(
            f"The exception {entry.name} asks for the character group "
            f"{entry.group_name or 'of no name'}, and there is none: "
            f"choose one of {', '.join(names)}."
        )
    return Edit(
        agents,
        move=tuple(entry.move) if entry.kind == "NUDGE" else (0.0, 0.0, 0.0),
        turn=entry.turn if entry.kind == "TURN" else 0.0,
        group=names.index(entry.group_name) if entry.kind == "GROUP" else None,
        hide=entry.kind == HIDE,
    )
