"""What all our node groups do alike: a mark and a version say which is ours and of what make; a stale one is rebuilt in
place."""

from collections.abc import Callable, Sequence

import bpy

KIND, TREE_VERSION = "crowd_lod_tree", "version"  # custom properties of a tree


def made(kind: str) -> bpy.types.GeometryNodeTree | None:
    """This file's own tree of that kind, whatever it is called now; a tree of the user's by the same name is not it."""
    for tree in bpy.data.node_groups:
        marked = tree.get(KIND) == kind or (tree.name == kind and TREE_VERSION in tree)  # before version 3 by name alone
        if marked and tree.bl_idname == "GeometryNodeTree" and tree.library is None:
            return tree
    return None


def is_ours(tree: bpy.types.NodeTree | None) -> bool:
    """Whether it is a tree of ours, of any kind and version."""
    return tree is not None and (KIND in tree or tree.name.startswith("Crowd LOD ") and TREE_VERSION in tree)


def stale(kind: str, version: int) -> bool:
    """Whether this file holds a tree of that kind that is of another version."""
    tree = made(kind)
    return tree is not None and tree.get(TREE_VERSION) != version


def current(kind: str, version: int, wire: Callable[[bpy.types.GeometryNodeTree], None]) -> bpy.types.GeometryNodeTree:
    """The tree of that kind and version, made or made anew by `wire` where need be."""
    tree = made(kind)
    if tree is None:
        tree = bpy.data.node_groups.new(kind, "GeometryNodeTree")
    elif tree.get(TREE_VERSION) == version:
        return tree
    tree.nodes.clear()
    tree.interface.clear()
    wire(tree)
    tree[KIND], tree[TREE_VERSION] = kind, version
    return tree


def spread(*rows: Sequence[bpy.types.Node]) -> None:
    """Place the nodes in rows, from left to right."""
    for row, nodes in enumerate(rows):
        for column, node in enumerate(nodes):
            node.location = (180 * column, -200 * row)


def attribute(tree: bpy.types.GeometryNodeTree, name: str, kind: str) -> bpy.types.NodeSocket:
    """The named attribute of the points, of a type such as FLOAT; 0 where they have none."""
    node = tree.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(s for s in node.outputs if s.enabled and s.name == "Attribute")
