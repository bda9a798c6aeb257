"""Lengths whose defaults are meant in meters, in scenes whose unit is another."""

import bpy

from ..blender import scene_data

# settings of crowds and of the scene: lengths whose default is in meters
LENGTHS = "size", "row_depth", "height_scale", "margin"


def set_lengths(scene: bpy.types.Scene) -> None:
    """Set lengths that still have their default to as many meters.

    Settings hold lengths in the scene's units, and a property's default cannot follow these.
    """
    meters = scene_data.meters(scene)
    if meters == 1:
        return
    for crowd in (scene.crowd_lod, *scene.crowd_lod.crowds):
        kinds = crowd.bl_rna.properties
        for name in LENGTHS:
            if name in kinds and not crowd.is_property_set(name):
                default = (
                    kinds[name].default_array if kinds[name].is_array else [kinds[name].default]
                )
                lengths = [length / meters for length in default]
                setattr(crowd, name, lengths if kinds[name].is_array else lengths[0])
