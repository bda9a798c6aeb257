"""Detects whether a build is up to date: then its characters stay as they are.

Its rigs are told by what they play.
"""

from collections.abc import Iterable

import bpy
import numpy as np

from ...crowd_lod.sources.trajectory import Trajectory
from ..blender.animation import curves_of, players_of
from ..blender.contents import custom_properties, read_columns, still_inputs
from ..blender.objects import SHOWN
from ..blender.provenance import text_digest


def played_numbers(trajectory: Trajectory) -> list[float]:
    """Return the numbers on which rigs depend that play as agents of `trajectory` do."""
    gaits = trajectory.gaits
    own = trajectory.seconds_per_frame, gaits.classes, *np.concatenate(gaits.distinct)
    return [float(each) for each in own]


def played_actions(trajectory: Trajectory) -> str:
    """Return the names of the actions that rigs play, a line for each group.

    "" if all play their own alone.
    """
    names = trajectory.gaits.actions
    return (
        "\n".join(", ".join(names[k] for k, _ in own) for own in trajectory.gaits.plays)
        if any(names)
        else ""
    )


CORNERS = (("co", 2, "f4"),)  # of a curve's keys: the rest is the same in all that rigs play


def named_by(homes: Iterable[bpy.types.Collection]) -> str:
    """Return a hash of what a build takes from LODs besides what they are: names, and how shown.

    homes: the collections of the LODs.
    """
    items = {item: None for home in homes for item in home.objects}
    places = [
        (home.name, tuple(home.instance_offset), [item.name for item in home.objects])
        for home in homes
    ]
    return text_digest(places, [(_shown(item), _holds(item)) for item in items])


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
    return text_digest(inside, keys, strips, [(_shown(item), _holds(item)) for item in items])


def _shown(item: bpy.types.Object) -> list:
    """Return how renders show the object: flags, materials, its own properties, its lights."""
    linking = item.light_linking
    linked = [
        home and home.name_full
        for home in (linking.receiver_collection, linking.blocker_collection)
    ]
    slots = [(slot.link, slot.material and slot.material.name_full) for slot in item.material_slots]
    flags = [repr(getattr(item, name)) for name in SHOWN]
    return [*flags, slots, *custom_properties(item), item.lightgroup, linked]


def _holds(item: bpy.types.Object) -> tuple:
    """Return the object's data, what moves it, and where it stands, by name."""
    modifiers = [
        (m.name, m.type, m.show_render, m.show_viewport, getattr(m, "object", None))
        for m in item.modifiers
    ]
    modifier_names = [(*each, other and other.name) for *each, other in modifiers]
    sizes = (len(item.data.vertices), len(item.data.loops)) if item.type == "MESH" else ()
    return (
        item.name,
        item.data and item.data.name_full,
        sizes,
        item.parent and item.parent.name,
        item.parent_bone,
        np.array([*item.matrix_basis, *item.matrix_parent_inverse]).tolist(),
        modifier_names,
        [(path, getattr(value, "name_full", value)) for path, value in still_inputs(item)],
    )
