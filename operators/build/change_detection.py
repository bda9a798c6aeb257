"""Detects whether a build is up to date: then its characters stay as they are."""

from collections.abc import Iterable

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.planning.planned import numbers_of
from ..blender import mesh_data, scene_data
from ..blender.provenance import text_digest
from ..blender.rig_dependencies import curves_of, custom, players_of, read_columns, stance

CORNERS = (("co", 2, "f4"),)  # of a curve's keys: the rest is the same in all that rigs play


def made_of(homes: Iterable[bpy.types.Collection], played: list) -> str:
    """Return a hash of the inputs of a build's characters, and of how rigs play.

    homes: the collections of the LODs. The mesh data is left out: LODs and build share it.
    """
    items = {item: None for home in homes for item in home.objects}
    looks = [[*map(repr, (getattr(item, name) for name in mesh_data.SHOWN)), _slots(item), _properties(item)] for item in items]
    places = [(home.name, tuple(home.instance_offset), [item.name for item in home.objects]) for home in homes]
    return text_digest(places, played, looks, [_holds(item) for item in items], stance(*items))


def shown_by(top: bpy.types.Collection) -> str:
    """Return a hash of the build `top`: collections, objects, and what its rigs play."""
    inside = [(child.name, [item.name for item in child.objects]) for child in top.children_recursive]
    items = {item: None for child in top.children_recursive for item in child.objects}
    actions = {player.action: player for player in players_of(items) if player.action is not None}
    keys = [
        (
            action.name,
            [(curve.data_path, curve.array_index, read_columns(curve.keyframe_points, CORNERS)) for curve in curves_of(player)],
        )
        for action, player in actions.items()
    ]
    strips = [[strip.action and strip.action.name for track in item.animation_data.nla_tracks for strip in track.strips]
              for item in items if item.animation_data]  # fmt: skip
    looks = [[*map(repr, (getattr(item, name) for name in mesh_data.SHOWN)), _slots(item), _properties(item)] for item in items]
    return text_digest(inside, keys, strips, looks, [_holds(item) for item in items])


def _properties(item: bpy.types.Object) -> list:
    linked = [home and home.name_full for home in (item.light_linking.receiver_collection, item.light_linking.blocker_collection)]
    return [*custom(item), item.lightgroup, linked]


def cameras_digest(cameras: Iterable[Camera]) -> str:
    """Return a hash of a frame's cameras."""
    return text_digest(numbers_of(tuple(cameras)).round(5).tolist())[:8]


def _curves(item: bpy.types.Object) -> list[bpy.types.FCurve]:
    """Return the drivers and F-curves that animate the object itself."""
    data = item.animation_data
    return [*data.drivers, *(curve for player in players_of([item]) for curve in curves_of(player))] if data is not None else []


def _node_inputs(item: bpy.types.Object) -> list[tuple[str, str]]:
    """Return (RNA path, value as text) of each input of Nodes modifiers that nothing animates."""
    modifiers = [modifier for modifier in item.modifiers if modifier.type == "NODES"]
    inputs = {m.path_from_id() + path: value for m in modifiers for path, value in scene_data.node_inputs(m).items()}
    animated = {curve.data_path for curve in _curves(item)}
    return sorted((path, repr(value)) for path, value in inputs.items() if path not in animated)


def _holds(item: bpy.types.Object, still: bool = True) -> tuple:
    """Return the object's data, what moves it, and, if it stands `still`, where."""
    modifiers = [(m.name, m.type, m.show_render, m.show_viewport, getattr(m, "object", None)) for m in item.modifiers]
    named = [(*each, other and other.name) for *each, other in modifiers]
    sizes = (len(item.data.vertices), len(item.data.loops)) if item.type == "MESH" else ()
    places = np.array([*item.matrix_basis, *item.matrix_parent_inverse]).tolist() if still else []
    return (
        item.name,
        item.data and item.data.name_full,
        sizes,
        item.parent and item.parent.name,
        item.parent_bone,
        places,
        named,
        _node_inputs(item),
    )


def _slots(item: bpy.types.Object) -> list:
    return [(slot.link, slot.material and slot.material.name_full) for slot in item.material_slots]
