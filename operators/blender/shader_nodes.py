"""The shader nodes of materials, lamps and worlds.

Up to Blender 4.5 (for lamps up to 5.1) they are switched on by `use_nodes`. Since then they are
always on, and `use_nodes` warns of its end.
"""

import bpy

Shaded = bpy.types.Material | bpy.types.Light | bpy.types.World


def used_nodes(shaded: Shaded) -> bpy.types.NodeTree | None:
    """Return the nodes that `shaded` is rendered with."""
    return shaded.node_tree if _is_always_on(shaded) or shaded.use_nodes else None


def switch_nodes_on(shaded: Shaded) -> bpy.types.NodeTree:
    """Have `shaded` rendered with its nodes, and return them."""
    if not _is_always_on(shaded):
        shaded.use_nodes = True
    return shaded.node_tree


def _is_always_on(shaded: Shaded) -> bool:
    switch = shaded.bl_rna.properties.get("use_nodes")
    return switch is None or getattr(switch, "is_deprecated", False)
