"""Data-blocks that an object uses through nodes, particles and instances."""

from collections.abc import Iterable, Iterator

import bpy

from .rig_dependencies import movers_of
from .scene_data import node_inputs


def reached(item: bpy.types.Object) -> set[bpy.types.ID]:
    """Return all data-blocks that `item` shows or instances, also indirectly.

    These are node groups, materials, objects and collections.
    """
    found, left = set(), list(_named(item))
    while left:
        block = left.pop()
        if block not in found:
            found.add(block)
            left += _named(block)
    return found


def closure_of(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return `objects` and all others without which they would stand, move or look otherwise.

    These are parents, the objects that modifiers, constraints and drivers refer to, what nodes and
    instances show, and all that these need in turn.
    """
    closure = movers_of(list(objects))
    while True:
        shown = {block for item in closure for block in reached(item) if isinstance(block, bpy.types.Object)}
        if shown.issubset(closure):
            return closure
        closure = movers_of([*closure, *shown.difference(closure)])


def _named(block: bpy.types.ID) -> Iterator[bpy.types.ID]:
    if isinstance(block, bpy.types.Object):
        yield from (slot.material for slot in block.material_slots if slot.material is not None)
        if block.instance_type == "COLLECTION" and block.instance_collection is not None:
            yield block.instance_collection
        elif block.instance_type in ("VERTS", "FACES"):
            yield from block.children
        for modifier in block.modifiers:
            if modifier.type == "NODES" and modifier.node_group is not None:
                yield modifier.node_group
                yield from (value for value in node_inputs(modifier).values() if isinstance(value, bpy.types.ID))
        for system in block.particle_systems:
            yield from filter(None, (system.settings.instance_object, system.settings.instance_collection))
    elif isinstance(block, bpy.types.Collection):
        yield from block.all_objects
    elif isinstance(block, bpy.types.GeometryNodeTree):
        for node in block.nodes:
            values = [getattr(node, name, None) for name in ("node_tree", "material", "object", "collection")]
            values += [getattr(each, "default_value", None) for each in node.inputs]
            yield from (value for value in values if isinstance(value, bpy.types.ID))
