"""The crowds of a scene: all of them, the one that the sidebar shows, and the first.

A new scene has none. Who draws, looks or renders takes `crowds_of` or `active_crowd`, which never
make one.
"""

import bpy
import numpy as np

from ..blender import scene_data, stored_values


def crowds_of(settings: bpy.types.PropertyGroup) -> list[bpy.types.PropertyGroup]:
    """Return the settings of each crowd of a scene."""
    return [*settings.crowds]


def active_crowd(settings: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup | None:
    """Return the crowd that the sidebar shows and its buttons change; None if there is none."""
    return settings.crowds[index_of_active(settings)] if len(settings.crowds) else None


def index_of_active(settings: bpy.types.PropertyGroup) -> int:
    """Return the active crowd's place among all; -1 if there is none."""
    return min(settings.crowd_index, len(settings.crowds) - 1)


def active_or_new(settings: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Return the active crowd, made if the scene has none."""
    return active_crowd(settings) or add_crowd(settings)


def first_crowd(settings: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Return the scene's first crowd, made if there is none."""
    return settings.crowds[0] if len(settings.crowds) else add_crowd(settings)


def add_crowd(settings: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Add a crowd with a name of its own; what was held of the others is not valid any longer."""
    taken = {crowd.name for crowd in settings.crowds}
    number = len(taken) + 1
    while f"Crowd {number}" in taken:
        number += 1
    crowd = settings.crowds.add()
    crowd.name = f"Crowd {number}"
    return crowd


def check_stored(settings: bpy.types.PropertyGroup) -> None:
    """Raise CrowdError if a setting of the scene or of a crowd has a value that it cannot have."""
    for each in (settings, *settings.crowds):
        stored_values.check(each)


def set_lengths(scene: bpy.types.Scene) -> None:
    """Set lengths that still have their default to as many meters.

    Settings hold lengths in the scene's units, and a property's default cannot follow these.
    """
    meters = scene_data.meters(scene)
    if meters == 1:
        return
    for owner in (scene.crowd_lod, *scene.crowd_lod.crowds):
        for setting in owner.bl_rna.properties:
            if setting.type != "FLOAT" or setting.unit != "LENGTH":
                continue
            default = [*setting.default_array] if setting.is_array else setting.default
            if np.any(default) and not owner.is_property_set(setting.identifier):
                lengths = np.divide(default, meters).tolist()
                setattr(owner, setting.identifier, lengths)
