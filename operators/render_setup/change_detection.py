"""Detects whether a build is up to date: then its characters stay as they are."""

from collections.abc import Iterable

import bpy

from ..blender import mesh_data
from ..blender.animation import curves_of, players_of
from ..blender.provenance import text_digest
from ..blender.rig_dependencies import custom_properties, read_columns, stance
from ..lod_meshes.cast_digest import holds, slots

CORNERS = (("co", 2, "f4"),)  # of a curve's keys: the rest is the same in all that rigs play


def made_of(homes: Iterable[bpy.types.Collection], played: list) -> str:
    """Return a hash of the inputs of a build's characters, and of how rigs play.

    homes: the collections of the LODs. The mesh data is left out: LODs and build share it.
    """
    items = {item: None for home in homes for item in home.objects}
    materials = [
        [
            *map(repr, (getattr(item, name) for name in mesh_data.SHOWN)),
            slots(item),
            _properties(item),
        ]
        for item in items
    ]
    places = [
        (home.name, tuple(home.instance_offset), [item.name for item in home.objects])
        for home in homes
    ]
    return text_digest(places, played, materials, [holds(item) for item in items], stance(*items))


def shown_by(top: bpy.types.Collection) -> str:
    """Return a hash of the build `top`: collections, objects, and what its rigs play."""
    inside = [
        (child.name, [item.name for item in child.objects]) for child in top.children_recursive
    ]
    items = {item: None for child in top.children_recursive for item in child.objects}
    actions = {player.action: player for player in players_of(items) if player.action is not None}
    keys = [
        (
            action.name,
            [
                (curve.data_path, curve.array_index, read_columns(curve.keyframe_points, CORNERS))
                for curve in curves_of(player)
            ],
        )
        for action, player in actions.items()
    ]
    strips = [
        [
            strip.action and strip.action.name
            for track in item.animation_data.nla_tracks
            for strip in track.strips
        ]
        for item in items
        if item.animation_data
    ]
    materials = [
        [
            *map(repr, (getattr(item, name) for name in mesh_data.SHOWN)),
            slots(item),
            _properties(item),
        ]
        for item in items
    ]
    return text_digest(inside, keys, strips, materials, [holds(item) for item in items])


def _properties(item: bpy.types.Object) -> list:
    linked = [
        home and home.name_full
        for home in (item.light_linking.receiver_collection, item.light_linking.blocker_collection)
    ]
    return [*custom_properties(item), item.lightgroup, linked]
