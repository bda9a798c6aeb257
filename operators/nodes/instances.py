"""The node group that puts a LOD's character collections on a bucket's points."""

import bpy

from .trees import attribute, current, spread

NAME = "Crowd LOD Instances"
VERSION = 4


def instances() -> bpy.types.GeometryNodeTree:
    """The group of this version: points with heading, pitch, roll (radians) and pose (index) in, collection instances
    out, turned by Rz(heading) Ry(-pitch) Rx(roll) Rz(Turn). Points without pitch and roll stand upright. Points with a
    blend above 0 show a mesh between two poses: of the points with `mixes` each makes one, of so much of the pose `beside` and
    the rest of `pose`, its vertices' velocities by how much the two differ, blend_rate times a second; `mixed` is whose,
    counted in order.

    Inputs: Geometry, Characters (a collection with one child a pose, in natural order of names), Turn (radians about z
    that turn a character to +x). A group of another version is rebuilt in place, so that files saved with it follow;
    its modifiers then need their inputs again.
    """
    return current(NAME, VERSION, _wire)


def _wire(tree: bpy.types.GeometryNodeTree) -> None:
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Characters", in_out="INPUT", socket_type="NodeSocketCollection")
    tree.interface.new_socket("Turn", in_out="INPUT", socket_type="NodeSocketFloat")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry = tree.nodes.new("NodeGroupInput")
    leave = tree.nodes.new("NodeGroupOutput")

    characters = tree.nodes.new("GeometryNodeCollectionInfo")
    characters.inputs["Separate Children"].default_value = True
    tree.links.new(entry.outputs["Characters"], characters.inputs["Collection"])

    heading, pitch, roll = (attribute(tree, name, "FLOAT") for name in ("heading", "pitch", "roll"))
    pose = attribute(tree, "pose", "INT")
    down = tree.nodes.new("ShaderNodeMath")
    down.operation = "MULTIPLY"
    down.inputs[1].default_value = -1.0
    tree.links.new(pitch, down.inputs[0])
    # Euler angles turn about the world's x, then y, then z
    stance = _rotation(tree, X=roll, Y=down.outputs["Value"], Z=heading)
    turn = _rotation(tree, Z=entry.outputs["Turn"])
    whole = tree.nodes.new("FunctionNodeRotateRotation")
    whole.rotation_space = "LOCAL"
    tree.links.new(stance, whole.inputs["Rotation"])
    tree.links.new(turn, whole.inputs["Rotate By"])

    blend = attribute(tree, "blend", "FLOAT")
    part = tree.nodes.new("GeometryNodeSeparateGeometry")
    tree.links.new(entry.outputs["Geometry"], part.inputs["Geometry"])
    tree.links.new(blend, part.inputs["Selection"])
    place = tree.nodes.new("GeometryNodeInstanceOnPoints")
    place.inputs["Pick Instance"].default_value = True
    tree.links.new(part.outputs["Inverted"], place.inputs["Points"])
    tree.links.new(characters.outputs[0], place.inputs["Instance"])
    tree.links.new(pose, place.inputs["Instance Index"])
    tree.links.new(whole.outputs["Rotation"], place.inputs["Rotation"])
    makers = tree.nodes.new("GeometryNodeSeparateGeometry")
    tree.links.new(part.outputs["Selection"], makers.inputs["Geometry"])
    tree.links.new(attribute(tree, "mixes", "INT"), makers.inputs["Selection"])
    each, inner, meshes = _meshes(tree, makers.outputs["Selection"], characters.outputs[0], pose, blend)
    near = tree.nodes.new("GeometryNodeInstanceOnPoints")
    near.inputs["Pick Instance"].default_value = True
    tree.links.new(part.outputs["Selection"], near.inputs["Points"])
    tree.links.new(meshes, near.inputs["Instance"])
    tree.links.new(attribute(tree, "mixed", "INT"), near.inputs["Instance Index"])
    tree.links.new(whole.outputs["Rotation"], near.inputs["Rotation"])
    both = tree.nodes.new("GeometryNodeJoinGeometry")
    tree.links.new(near.outputs["Instances"], both.inputs["Geometry"])
    tree.links.new(place.outputs["Instances"], both.inputs["Geometry"])
    tree.links.new(both.outputs["Geometry"], leave.inputs["Geometry"])

    upper = entry, characters, down, stance.node, turn.node, whole, part, place, makers, near, both, leave
    spread(upper, (pose.node, heading.node, pitch.node, roll.node, blend.node, *each), inner)


def _meshes(tree, points, characters, pose, blend) -> tuple[list, list, bpy.types.NodeSocket]:
    """(nodes, the nodes of its zone, geometry): of each of the `points` an instance of what lies between its two poses."""
    before = set(tree.nodes)
    entry, leave = (tree.nodes.new(f"GeometryNodeForeachGeometryElement{end}") for end in ("Input", "Output"))
    entry.pair_with_output(leave)
    leave.domain = "POINT"
    tree.links.new(points, entry.inputs["Geometry"])
    of_point = {
        "pose": pose,
        "beside": attribute(tree, "beside", "INT"),
        "blend": blend,
        "rate": attribute(tree, "blend_rate", "FLOAT"),
    }
    for name, value in of_point.items():
        leave.input_items.new("INT" if value.type == "INT" else "FLOAT", name)
        tree.links.new(value, entry.inputs[name])
    outer = [node for node in tree.nodes if node not in before]
    before |= set(outer)

    one = tree.nodes.new("GeometryNodePoints")
    meshes = []
    for name in ("pose", "beside"):
        place = tree.nodes.new("GeometryNodeInstanceOnPoints")
        place.inputs["Pick Instance"].default_value = True
        tree.links.new(one.outputs[0], place.inputs["Points"])
        tree.links.new(characters, place.inputs["Instance"])
        tree.links.new(entry.outputs[name], place.inputs["Instance Index"])
        real = tree.nodes.new("GeometryNodeRealizeInstances")
        tree.links.new(place.outputs["Instances"], real.inputs["Geometry"])
        meshes.append(real.outputs["Geometry"])
    here, index = tree.nodes.new("GeometryNodeInputPosition"), tree.nodes.new("GeometryNodeInputIndex")
    there = tree.nodes.new("GeometryNodeSampleIndex")
    there.data_type = "FLOAT_VECTOR"
    tree.links.new(meshes[1], there.inputs["Geometry"])
    tree.links.new(here.outputs[0], there.inputs["Value"])
    tree.links.new(index.outputs[0], there.inputs["Index"])
    way = _vector(tree, "SUBTRACT", there.outputs["Value"], here.outputs[0])
    store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
    store.data_type, store.domain = "FLOAT_VECTOR", "POINT"
    store.inputs["Name"].default_value = "velocity"
    tree.links.new(meshes[0], store.inputs["Geometry"])
    tree.links.new(_vector(tree, "SCALE", way, entry.outputs["rate"]), store.inputs["Value"])
    moved = tree.nodes.new("GeometryNodeSetPosition")
    tree.links.new(store.outputs["Geometry"], moved.inputs["Geometry"])
    tree.links.new(_vector(tree, "SCALE", way, entry.outputs["blend"]), moved.inputs["Offset"])
    whole = tree.nodes.new("GeometryNodeGeometryToInstance")
    tree.links.new(moved.outputs["Geometry"], whole.inputs["Geometry"])
    made = next(socket for socket in leave.inputs if socket.type == "GEOMETRY" and socket.name == "Geometry")
    tree.links.new(whole.outputs["Instances"], made)
    geometry = [socket for socket in leave.outputs if socket.type == "GEOMETRY"][-1]
    return outer, [node for node in tree.nodes if node not in before], geometry


def _vector(tree, operation: str, *values: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The result of a vector math node; the second input of SCALE is a number."""
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = operation
    tree.links.new(values[0], node.inputs[0])
    tree.links.new(values[1], node.inputs["Scale" if operation == "SCALE" else 1])
    return node.outputs["Vector"]


def _rotation(tree, **angles: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The rotation of Euler angles in radians."""
    euler, rotation = tree.nodes.new("ShaderNodeCombineXYZ"), tree.nodes.new("FunctionNodeEulerToRotation")
    for axis, socket in angles.items():
        tree.links.new(socket, euler.inputs[axis])
    tree.links.new(euler.outputs["Vector"], rotation.inputs["Euler"])
    return rotation.outputs["Rotation"]
