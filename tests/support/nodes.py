"""Nodes modifiers with an input of each kind."""

import bpy
from crowd_lod_extension.operators.blender.scene_data import set_node_input

# kind of socket -> its value at first, and another one; those that name data-blocks have none at
# first
INPUTS = {
    "Float": (1.0, 2.0),
    "Int": (1, 2),
    "Bool": (False, True),
    "Vector": ((1.0, 0.0, 0.0), (1.0, 0.0, 3.0)),
    "Color": ((1.0, 0.0, 0.0, 1.0), (1.0, 0.5, 0.0, 1.0)),
    "Rotation": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "String": ("a", "b"),
    "Menu": ("A", "B") if bpy.app.version >= (5, 2, 0) else (2, 3),
}
BLOCKS = ("Object", "Collection", "Material", "Image")


def nodes_modifier(item):
    """A Nodes modifier whose group has an input of each kind and hands the geometry on."""
    group = bpy.data.node_groups.new("Group", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    for kind in (*INPUTS, *BLOCKS, "Matrix"):
        group.interface.new_socket(kind, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    ends = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(ends[0].outputs[0], ends[1].inputs[0])
    group.links.new(
        ends[0].outputs["Menu"], group.nodes.new("GeometryNodeMenuSwitch").inputs["Menu"]
    )
    modifier = item.modifiers.new("Nodes", "NODES")
    modifier.node_group = group
    bpy.context.view_layer.update()
    for kind, (value, _) in INPUTS.items():
        set_node_input(modifier, kind, value)
    return modifier


def geometry_nodes(item, *kinds):
    """The node group of a new modifier of `item`, its input, a node of each of these kinds, and its
    output.
    """
    group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    item.modifiers.new("Nodes", "NODES").node_group = group
    return group, *map(group.nodes.new, ("NodeGroupInput", *kinds, "NodeGroupOutput"))
