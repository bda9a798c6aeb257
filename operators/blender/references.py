"""Data-blocks that an object uses through nodes, particles and instances."""

from collections.abc import Iterator

import bpy


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
                yield from _inputs(modifier)
        for system in block.particle_systems:
            yield from filter(None, (system.settings.instance_object, system.settings.instance_collection))
    elif isinstance(block, bpy.types.Collection):
        yield from block.all_objects
    elif isinstance(block, bpy.types.GeometryNodeTree):
        for node in block.nodes:
            values = [getattr(node, name, None) for name in ("node_tree", "material", "object", "collection")]
            values += [getattr(each, "default_value", None) for each in node.inputs]
            yield from (value for value in values if isinstance(value, bpy.types.ID))


def _inputs(modifier: bpy.types.NodesModifier) -> Iterator[bpy.types.ID]:
    """Yield the data-blocks chosen in the inputs of the modifier's node group."""
    if bpy.app.version >= (5, 2, 0):
        values = (getattr(each, "value", None) for each in _members(modifier.properties.inputs))
    else:
        values = (modifier[name] for name in modifier.keys())
    yield from (value for value in values if isinstance(value, bpy.types.ID))


def _members(struct) -> Iterator:
    yield from (getattr(struct, name) for name, kind in struct.bl_rna.properties.items() if kind.type == "POINTER")
