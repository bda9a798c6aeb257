"""Lengths whose defaults are meant in meters, in scenes whose unit is another."""

import bpy
import numpy as np

from ..blender import scene_data


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
