"""The node group that instances the points of the current frame of many."""

import bpy

from . import instances
from .trees import attribute, current, spread

NAME = "Crowd LOD Baked"
VERSION = 4


def baked() -> bpy.types.GeometryNodeTree:
    """Return the node group that shows baked points without a handler.

    Points: of many frames, with the attribute frame (INT). Collection instances of the points come
    out whose frame's shutter is open.

    Inputs: those of instances.instances; Rate (frames of the timeline per frame of the animation);
    Opens (part of a frame by which the shutter opens before it).

    Points may have velocities: move_before and move_after, meters per frame, and turn_before and
    turn_after (roll, pitch, heading), radians per frame. "before" holds until the frame, "after"
    from it on.
    """
    return current(NAME, VERSION, _wire)


def _wire(tree: bpy.types.GeometryNodeTree) -> None:
    for name, kind in (
        ("Geometry", "Geometry"),
        ("Characters", "Collection"),
        ("Turn", "Float"),
        ("LOD", "Int"),
        ("Rate", "Float"),
        ("Opens", "Float"),
    ):
        tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry = tree.nodes.new("NodeGroupInput")
    leave = tree.nodes.new("NodeGroupOutput")
    clock = tree.nodes.new("GeometryNodeInputSceneTime")
    time = _math(tree, "MULTIPLY", clock.outputs["Frame"], entry.outputs["Rate"])
    frame = _math(tree, "FLOOR", _math(tree, "ADD", time, entry.outputs["Opens"]))
    away = _math(tree, "SUBTRACT", time, frame)  # frames; below 0 before the frame

    other = _math(tree, "ABSOLUTE", _math(tree, "SUBTRACT", attribute(tree, "frame", "INT"), frame))
    now = tree.nodes.new("GeometryNodeSeparateGeometry")
    tree.links.new(entry.outputs["Geometry"], now.inputs["Geometry"])
    tree.links.new(_math(tree, "LESS_THAN", other, 0.5), now.inputs["Selection"])

    before = _math(tree, "LESS_THAN", away, 0.0)
    moved = tree.nodes.new("GeometryNodeSetPosition")
    tree.links.new(now.outputs["Selection"], moved.inputs["Geometry"])
    tree.links.new(_velocity(tree, "move", before, away), moved.inputs["Offset"])
    turned = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(_velocity(tree, "turn", before, away), turned.inputs["Vector"])
    geometry = moved.outputs["Geometry"]
    stores = []
    for axis, name in (("X", "roll"), ("Y", "pitch"), ("Z", "heading")):
        store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        store.data_type = "FLOAT"
        store.domain = "POINT"
        store.inputs["Name"].default_value = name
        tree.links.new(geometry, store.inputs["Geometry"])
        tree.links.new(
            _math(tree, "ADD", attribute(tree, name, "FLOAT"), turned.outputs[axis]),
            store.inputs["Value"],
        )
        geometry = store.outputs["Geometry"]
        stores.append(store)

    place = tree.nodes.new("GeometryNodeGroup")
    place.node_tree = instances.instances()
    tree.links.new(geometry, place.inputs["Geometry"])
    for name in ("Characters", "Turn", "LOD"):
        tree.links.new(entry.outputs[name], place.inputs[name])
    tree.links.new(place.outputs["Geometry"], leave.inputs["Geometry"])

    upper = entry, now, moved, *stores, place, leave
    spread(upper, [node for node in tree.nodes if node not in upper])


def _math(tree, operation: str, *values) -> bpy.types.NodeSocket:
    """Return the result of a math node on sockets and numbers."""
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for socket, value in zip(node.inputs, values, strict=False):
        if isinstance(value, float):
            socket.default_value = value
        else:
            tree.links.new(value, socket)
    return node.outputs["Value"]


def _velocity(
    tree, name: str, before: bpy.types.NodeSocket, away: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the displacement since the frame, by the velocity before or after it."""
    either = tree.nodes.new("GeometryNodeSwitch")
    either.input_type = "VECTOR"
    tree.links.new(before, either.inputs["Switch"])
    tree.links.new(attribute(tree, f"{name}_after", "FLOAT_VECTOR"), either.inputs["False"])
    tree.links.new(attribute(tree, f"{name}_before", "FLOAT_VECTOR"), either.inputs["True"])
    way = tree.nodes.new("ShaderNodeVectorMath")
    way.operation = "SCALE"
    tree.links.new(either.outputs["Output"], way.inputs["Vector"])
    tree.links.new(away, way.inputs["Scale"])
    return way.outputs["Vector"]
