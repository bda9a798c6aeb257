"""Common functions of our node groups: a custom property and a version mark them.

A group of another version is rebuilt in place.
"""

from collections.abc import Callable, Sequence

import bpy

# custom properties of a tree
KIND = "crowd_lod_tree"
TREE_VERSION = "version"


def find_tree(kind: str) -> bpy.types.NodeTree | None:
    """Return this file's own tree of that kind, whatever its name is now, or None.

    A tree of the user's with the same name does not count.
    """
    for tree in bpy.data.node_groups:
        if tree.get(KIND) == kind and tree.library is None:
            return tree
    return None


def is_ours(tree: bpy.types.NodeTree | None) -> bool:
    """Return whether this is a tree of ours, of any kind and version."""
    return tree is not None and KIND in tree


def stale(kind: str, version: int) -> bool:
    """Return whether this file holds a tree of that kind in another version."""
    tree = find_tree(kind)
    return tree is not None and tree.get(TREE_VERSION) != version


def current(
    kind: str,
    version: int,
    wire: Callable[[bpy.types.NodeTree], None],
    nodes: str = "GeometryNodeTree",
) -> bpy.types.NodeTree:
    """Return the tree of that kind and version; `wire` makes or remakes it if needed.

    nodes: the type of tree.
    """
    tree = find_tree(kind)
    if tree is None:
        tree = bpy.data.node_groups.new(kind, nodes)
    elif tree.get(TREE_VERSION) == version:
        return tree
    tree.nodes.clear()
    tree.interface.clear()
    wire(tree)
    tree[KIND] = kind
    tree[TREE_VERSION] = version
    return tree


def spread(*rows: Sequence[bpy.types.Node]) -> None:
    """Place the nodes in rows, from left to right."""
    for row, nodes in enumerate(rows):
        for column, node in enumerate(nodes):
            node.location = (180 * column, -200 * row)


def attribute(tree: bpy.types.GeometryNodeTree, name: str, kind: str) -> bpy.types.NodeSocket:
    """Return the points' named attribute, of a type such as FLOAT; 0 if missing."""
    node = tree.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(s for s in node.outputs if s.enabled and s.name == "Attribute")
