"""What objects are made of: the data-blocks that they refer to, show and instance."""

from collections.abc import Iterable, Iterator

import bpy
from bpy_extras.id_map_utils import get_id_reference_map

from .scene_data import node_inputs


def reached_blocks(item: bpy.types.Object) -> set[bpy.types.ID]:
    """Return all data-blocks that `item` shows or instances, also indirectly.

    These are node groups, materials, objects and collections.
    """
    blocks = set()
    left = list(_blocks_named_by(item))
    while left:
        block = left.pop()
        if block not in blocks:
            blocks.add(block)
            left += _blocks_named_by(block)
    return blocks


def closure_of(objects: Iterable[bpy.types.Object], look: bool = True) -> list[bpy.types.Object]:
    """Return `objects` and all others that they are made of, at any depth.

    Blender itself says what refers to what: by parents, modifiers, constraints, drivers, nodes,
    particles, instances, data, or by anything else that a version of it knows. `objects` come
    first, all others are sorted by name. docs/notes/files.md says what is no part.

    look: whether materials, and what they alone refer to, count.
    """
    references = get_id_reference_map()
    no_part = (bpy.types.Scene,) if look else (bpy.types.Scene, bpy.types.Material)
    closure: dict[bpy.types.ID, None] = dict.fromkeys(objects)
    count = len(closure)
    left = list(closure)
    while left:
        block = left.pop()
        for other in references.get(block, set()) - _beside(block):
            if other not in closure and not isinstance(other, no_part):
                closure[other] = None
                left.append(other)
    items = list(closure)
    others = [block for block in items[count:] if isinstance(block, bpy.types.Object)]
    return items[:count] + sorted(others, key=lambda item: item.name_full)


def _beside(block: bpy.types.ID) -> set[bpy.types.ID | None]:
    """Return what `block` refers to without being made of it.

    This is the linked original of an override, and the collections that a lamp is to shine on.
    """
    override = block.override_library
    linking = getattr(block, "light_linking", None)
    collections = (
        {linking.receiver_collection, linking.blocker_collection} if linking is not None else set()
    )
    return collections | ({override.reference} if override is not None else set())


def _blocks_named_by(block: bpy.types.ID) -> Iterator[bpy.types.ID]:
    if isinstance(block, bpy.types.Object):
        yield from (slot.material for slot in block.material_slots if slot.material is not None)
        if block.instance_type == "COLLECTION" and block.instance_collection is not None:
            yield block.instance_collection
        elif block.instance_type in ("VERTS", "FACES"):
            yield from block.children
        for modifier in block.modifiers:
            if modifier.type == "NODES" and modifier.node_group is not None:
                yield modifier.node_group
                yield from (
                    value
                    for value in node_inputs(modifier).values()
                    if isinstance(value, bpy.types.ID)
                )
        for system in block.particle_systems:
            yield from filter(
                None, (system.settings.instance_object, system.settings.instance_collection)
            )
    elif isinstance(block, bpy.types.Collection):
        yield from block.all_objects
    elif isinstance(block, bpy.types.GeometryNodeTree):
        for node in block.nodes:
            values = [
                getattr(node, name, None)
                for name in ("node_tree", "material", "object", "collection")
            ]
            values += [getattr(each, "default_value", None) for each in node.inputs]
            yield from (value for value in values if isinstance(value, bpy.types.ID))
