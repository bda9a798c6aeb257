"""Whether characters were edited: quick hashes of what they are, to be asked while one works."""

from collections.abc import Iterable, Iterator

import bpy
import numpy as np

from ..blender import mesh_data, scene_data
from ..blender.animation import curves_and_drivers, moved_values, players_of
from ..blender.provenance import text_digest
from ..blender.references import blocks_of
from ..blender.rig_dependencies import moves_whole, read_tree, settings_of, shape_of

SAMPLED = 200  # vertices of a mesh, roughly


def cast_digest(items: Iterable[bpy.types.Object]) -> str:
    """Return a hash of characters: what they and all that they are made of hold and play.

    It is the same in all frames. A change of few vertices or keys may escape it.
    """
    blocks = blocks_of(list(items))
    parts = [block for block in blocks if isinstance(block, bpy.types.Object)]
    trees = [read_tree(block) for block in blocks if isinstance(block, bpy.types.GeometryNodeTree)]
    played = [
        (player.action.name_full, *player.action.frame_range)
        for player in players_of(parts)
        if player.action is not None
    ]
    return text_digest(
        [(holds(item, still=not _moves(item)), slots(item), *_made_of(item)) for item in parts],
        played,
        trees,
    )


def _moves(item: bpy.types.Object) -> bool:
    """Return whether the object's own place is animated, and so tells the frame."""
    return any(map(moves_whole, curves_and_drivers(item.animation_data)))


def _node_inputs(item: bpy.types.Object) -> list[tuple[str, str]]:
    """Return (RNA path, value as text) of each input of Nodes modifiers that nothing animates."""
    modifiers = [modifier for modifier in item.modifiers if modifier.type == "NODES"]
    inputs = {
        m.path_from_id() + path: value
        for m in modifiers
        for path, value in scene_data.node_inputs(m).items()
    }
    animated = {curve.data_path for curve in curves_and_drivers(item.animation_data)}
    return sorted((path, repr(value)) for path, value in inputs.items() if path not in animated)


def _made_of(item: bpy.types.Object) -> Iterator[list]:
    """Yield what else shapes and moves the object: modifiers, constraints, and its data.

    Of a mesh these are some of its vertices.
    """
    moved = moved_values(item)
    bones = item.pose.bones if item.pose is not None else ()
    constraints = [
        *item.constraints,
        *(constraint for bone in bones for constraint in bone.constraints),
    ]
    yield [settings_of(struct, moved) for struct in (*item.modifiers, *constraints)]
    if item.type == "MESH":
        yield mesh_data.some_vertices(item.data, SAMPLED)
    elif item.type != "ARMATURE" and item.data is not None:
        yield [settings_of(item.data, moved), *shape_of(item.data)]
    elif not moved:
        yield [tuple(map(tuple, bone.matrix_basis)) for bone in bones]


def holds(item: bpy.types.Object, still: bool = True) -> tuple:
    """Return the object's data, what moves it, and, if it stands `still`, where."""
    modifiers = [
        (m.name, m.type, m.show_render, m.show_viewport, getattr(m, "object", None))
        for m in item.modifiers
    ]
    modifier_names = [(*each, other and other.name) for *each, other in modifiers]
    sizes = (len(item.data.vertices), len(item.data.loops)) if item.type == "MESH" else ()
    places = np.array([*item.matrix_basis, *item.matrix_parent_inverse]).tolist() if still else []
    return (
        item.name,
        item.data and item.data.name_full,
        sizes,
        item.parent and item.parent.name,
        item.parent_bone,
        places,
        modifier_names,
        _node_inputs(item),
    )


def slots(item: bpy.types.Object) -> list:
    return [(slot.link, slot.material and slot.material.name_full) for slot in item.material_slots]
