"""Thresholds and sizes that push their neighbors along, as the stops of a color ramp do."""

from collections.abc import Callable

import bpy
import numpy as np
from idprop.types import IDPropertyArray

from ...crowd_lod.levels.assignment import pushed

METRIC_OF = {"thresholds": "AXIS", "sizes": "PIXELS"}
# custom property of the settings and of groups: the values of that name, before a change
BEFORE = "crowd_lod_before_{}"


def push(name: str) -> Callable:
    """Return an update callback of the property `name`, a key of METRIC_OF.

    The property is one of the settings or of a character group.
    """

    def update(owner: bpy.types.PropertyGroup, _) -> None:
        owner.id_data.crowd_lod.estimate = ""
        put_in_order(owner, name)

    return update


def push_all(settings: bpy.types.PropertyGroup, _) -> None:
    """Put thresholds and sizes in order after level_count has changed (update callback)."""
    settings.estimate = ""
    for owner in (settings, *settings.groups):
        for name in METRIC_OF:
            put_in_order(owner, name)


def note_thresholds(settings: bpy.types.PropertyGroup) -> None:
    """Remember thresholds and sizes as they are now.

    Needed where they were set without a call of their update callbacks.
    """
    for owner in (settings, *settings.groups):
        for name in METRIC_OF:
            owner[BEFORE.format(name)] = list(getattr(owner, name))


def put_in_order(owner: bpy.types.PropertyGroup, name: str) -> None:
    """Let the changed value of `name` push the others, as far as there are LODs.

    Blender does not tell which value of an array has changed, so the values before are kept beside.
    A value that is not a number becomes what it was.
    """
    values = np.array(getattr(owner, name), np.float64)
    before = _before(owner, name)
    changed = np.flatnonzero(values != before)
    ordered = np.where(np.isfinite(values), values, before)
    count = owner.id_data.crowd_lod.level_count - 1
    if count:
        pushing = min(changed[0], count - 1) if len(changed) else 0
        ordered[:count] = pushed(ordered[:count].tolist(), pushing, METRIC_OF[name])
    ordered = ordered.astype(np.float32)
    # noted before the property is set: setting it calls this again, which then finds no change
    owner[BEFORE.format(name)] = ordered.tolist()
    if (ordered != values).any():
        setattr(owner, name, ordered)


def _before(owner: bpy.types.PropertyGroup, name: str) -> np.ndarray:
    """Return the values of `name` that were noted last, the defaults where none were."""
    usual = np.array(owner.bl_rna.properties[name].default_array)
    noted = owner.get(BEFORE.format(name))
    if not isinstance(noted, IDPropertyArray) or len(noted) != len(usual):
        return usual
    return np.where(np.isfinite(noted), noted, usual)
