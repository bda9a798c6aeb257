"""Thresholds that push their neighbors along, as the stops of a color ramp do."""

import bpy
import numpy as np
from idprop.types import IDPropertyArray

from ...crowd_lod.levels.assignment import pushed

BEFORE = "crowd_lod_before"  # custom property of who has thresholds: those before a change


def push(owner: bpy.types.PropertyGroup, _) -> None:
    """Put the thresholds of the settings, or of a character group, in order (update callback)."""
    owner.id_data.crowd_lod.estimate = ""
    put_in_order(owner)


def push_all(settings: bpy.types.PropertyGroup, _) -> None:
    """Put all thresholds in order after level_count has changed (update callback)."""
    settings.estimate = ""
    for owner in (settings, *settings.groups):
        put_in_order(owner)


def note_thresholds(settings: bpy.types.PropertyGroup) -> None:
    """Remember thresholds as they are now.

    Needed where they were set without a call of their update callbacks.
    """
    for owner in (settings, *settings.groups):
        owner[BEFORE] = list(owner.thresholds)


def put_in_order(owner: bpy.types.PropertyGroup) -> None:
    """Let the changed threshold push the others, as far as there are LODs.

    Blender does not tell which value of an array has changed, so the values before are kept beside.
    A value that is not a number becomes what it was.
    """
    values = np.array(owner.thresholds, np.float64)
    before = _before(owner)
    changed = np.flatnonzero(values != before)
    ordered = np.where(np.isfinite(values), values, before)
    count = owner.id_data.crowd_lod.level_count - 1
    if count:
        pushing = min(changed[0], count - 1) if len(changed) else 0
        ordered[:count] = pushed(ordered[:count].tolist(), pushing)
    ordered = ordered.astype(np.float32)
    # noted before the property is set: setting it calls this again, which then finds no change
    owner[BEFORE] = ordered.tolist()
    if (ordered != values).any():
        owner.thresholds = ordered


def _before(owner: bpy.types.PropertyGroup) -> np.ndarray:
    """Return the thresholds that were noted last, the defaults where none were."""
    usual = np.array(owner.bl_rna.properties["thresholds"].default_array)
    noted = owner.get(BEFORE)
    if not isinstance(noted, IDPropertyArray) or len(noted) != len(usual):
        return usual
    return np.where(np.isfinite(noted), noted, usual)
