"""Has Blender evaluate the objects whose points are agents, also where they are hidden.

Users hide them from renders.
"""

import bpy

from ..blender import scene_data
from ..freshness.bake_frames import is_bake
from ..scene.sources.crowd_sources import is_live
from ..settings.crowds import crowds_of
from .shelves import points_of

WATCHED = "crowd_lod_watched"  # custom property of the node group
INPUT = "Object"


def watch_points(scene: bpy.types.Scene) -> None:
    """Let the scene's build depend on the objects that its live crowds read, and on no others.

    A modifier for each, on one of the build's point objects, names it and changes nothing.
    """
    points = points_of(scene.crowd_lod.build)
    for item in points.values():
        for modifier in [
            m
            for m in item.modifiers
            if m.type == "NODES" and m.node_group is not None and WATCHED in m.node_group
        ]:
            item.modifiers.remove(modifier)
    if not points or is_bake(scene.crowd_lod.build):
        return
    first = next(iter(points.values()))
    for crowd in filter(is_live, crowds_of(scene.crowd_lod)):
        modifier = first.modifiers.new(f"Points of {crowd.points.name}", "NODES")
        modifier.node_group = _nodes()
        scene_data.set_node_input(modifier, INPUT, crowd.points)


def _nodes() -> bpy.types.NodeTree:
    """Return a node group that hands its geometry on; that an object is among its inputs is
    enough.
    """
    for tree in bpy.data.node_groups:
        if WATCHED in tree and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new("Points that Crowd LOD reads", "GeometryNodeTree")
    tree[WATCHED] = True
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    tree.interface.new_socket(INPUT, in_out="INPUT", socket_type="NodeSocketObject")
    tree.links.new(
        tree.nodes.new("NodeGroupInput").outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0]
    )
    return tree
