"""Measured character groups, as the settings of a scene keep them."""

from typing import Any

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Action, Group
from ....crowd_lod.crowd.strides import Plays
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.levels.assignment import MOST_LEVELS
from ...blender.named_actions import find_action

# What settings and Group call the same. `on_ground` comes after `center`, which its update moves,
# and before `lowest`, without which it moves nothing.
MEASURED = (
    *("name", "center", "radius", "girth", "stride", "period", "diagonal", "on_ground", "lowest"),
    *("share", "scale", "variant_of", "chance", "slot", "way", "plays"),
)
OF_ACTIONS = "name", "stride", "period", "way", "plays"
OF_EACH_LEVEL = "vertices", "triangles", "deviations", "bounds", "rms", "worst"
# What users set: groups of the same name keep it.
SET_BY_HAND = "use_custom_thresholds", "thresholds", "finest", "share", "scale"


def groups_of(settings) -> tuple[Group, ...]:
    """Return the measured groups of the settings."""
    return tuple(_group(g, lead_of(g), count_of(settings)) for g in settings.groups)


def lead_of(entry: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Return the entry of the group whose agents wear the part `entry`; a group's own is itself."""
    return entry.variant_of and entry.id_data.crowd_lod.groups.get(entry.variant_of) or entry


def _group(entry, lead, count: int) -> Group:
    """Return the Group that `entry` of the settings holds, with at most `count` LODs.

    lead: see lead_of. CrowdError if its measurements are invalid.
    """
    count_made = sum(n > 0 for n in entry.triangles[:count])
    measured = count_made if entry.diagonal else 0
    # Blender keeps no infinity
    shaded = [np.inf if value > 1e30 else value for value in entry.shaded[:measured]]
    group = Group(
        entry.name,
        entry.center,
        entry.radius,
        entry.stride,
        entry.period,
        vertices=tuple(entry.vertices[:count_made]),
        triangles=tuple(entry.triangles[:count_made]),
        deviations=tuple(entry.deviations[:measured]),
        bounds=tuple(entry.bounds[:measured]),
        rms=tuple(entry.rms[:measured]),
        worst=tuple(entry.worst[:measured]),
        diagonal=entry.diagonal,
        shaded=tuple(shaded) if all(value >= 0 for value in shaded) else (),
        lowest=entry.lowest,
        on_ground=entry.on_ground,
        girth=entry.girth,
        share=round(lead.share, 6),
        scale=(round(min(lead.scale), 6), round(max(lead.scale), 6)),
        variant_of=entry.variant_of,
        chance=round(entry.chance, 6),
        slot=entry.slot,
        excludes=tuple(entry.excludes.split(", ")) if entry.excludes else (),
        actions=tuple(
            Action(**{name: getattr(action, name) for name in OF_ACTIONS})
            for action in entry.actions
        ),
        way=entry.way,
        plays=Plays(entry.plays),
    )
    sizes = (
        group.share,
        group.chance,
        *group.scale,
        *(value for action in group.actions for value in (action.stride, action.period)),
        group.radius,
        group.girth,
        group.stride,
        group.period,
        group.diagonal,
        *group.deviations,
        *group.bounds,
        *group.rms,
        *group.vertices,
    )
    if (
        not all(0 <= size < np.inf for size in sizes)
        or not np.isfinite([group.center, group.lowest, *group.worst]).all()
    ):
        raise CrowdError(
            f"The measurements of the character group {group.name} are damaged: press Populate, "
            f"then Make LOD Meshes."
        )
    return group


def count_of(settings, choice: str = "") -> int:
    """Return the number of LODs.

    By distance that is the setting, by tolerance the number of LODs made, or 1 before they are.

    choice: BY_DISTANCE or BY_TOLERANCE in place of the settings' own.
    """
    if (choice or settings.choice) == "BY_DISTANCE":
        return settings.level_count
    return len(settings.levels.children) if settings.levels is not None else 1


def store_groups(settings, groups: tuple[Group, ...]) -> None:
    """Store the measured groups in the scene's settings.

    Groups of the same name keep their own thresholds, finest LOD, share and scale.
    """
    by_hand = {
        entry.name: [_value(entry, name) for name in SET_BY_HAND] for entry in settings.groups
    }
    settings.groups.clear()
    for group in groups:
        entry = settings.groups.add()
        for name in MEASURED:
            setattr(entry, name, getattr(group, name))
        entry.excludes = ", ".join(group.excludes)
        for name in OF_EACH_LEVEL:
            values = getattr(group, name)
            setattr(entry, name, (*values, *[0] * (MOST_LEVELS - len(values))))
        entry.actions.clear()
        for action in group.actions:
            stored = entry.actions.add()
            stored.action = find_action(group.name, action.name)
            for name in OF_ACTIONS:
                setattr(stored, name, getattr(action, name))
        entry.shaded = (*group.shaded, *[-1] * (MOST_LEVELS - len(group.shaded)))
        for name, value in zip(SET_BY_HAND, by_hand.get(group.name, ()), strict=False):
            setattr(entry, name, value)


def _value(entry: bpy.types.PropertyGroup, name: str) -> Any:
    """Return a copy of the entry's value, which outlives the entry."""
    value = getattr(entry, name)
    return value if isinstance(value, bool | int | float) else tuple(value)
