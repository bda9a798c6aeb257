"""The image textures of materials."""

from collections.abc import Iterator

import bpy


def image_nodes(
    tree: bpy.types.NodeTree | None, path: tuple = ()
) -> Iterator[tuple[bpy.types.Node, tuple]]:
    """Yield a material's image texture nodes, each with its path of group nodes.

    The path begins with the outermost group.
    """
    for node in tree.nodes if tree else ():
        if node.type == "TEX_IMAGE" and node.image is not None:
            yield node, path
        elif node.type == "GROUP":
            yield from image_nodes(node.node_tree, (*path, node))
