"""The node group that puts a LOD's character collections on a bucket's points."""

import bpy

from .trees import attribute, current, spread

NAME = "Crowd LOD Instances"
VERSION = 7


def instances() -> bpy.types.GeometryNodeTree:
    """Return the node group that instances characters on points, in this version.

    Points: with the attributes heading, pitch, roll (radians) and pose (index). Instances of
    collections come out, turned by Rz(heading) Ry(-pitch) Rx(roll) Rz(Turn), and scaled by 1 +
    size. Points without pitch and roll stand upright; without size they have the character's.

    Inputs: Geometry, Characters (a collection with one child per character, in natural order of
    names), Turn (radians about z that turn a character to +x), LOD (a number that the instances
    carry as their attribute lod).

    A group of another version is rebuilt in place, so that files saved with it follow. Its
    modifiers then need their inputs again.
    """
    return current(NAME, VERSION, _wire)


def _wire(tree: bpy.types.GeometryNodeTree) -> None:
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Characters", in_out="INPUT", socket_type="NodeSocketCollection")
    tree.interface.new_socket("Turn", in_out="INPUT", socket_type="NodeSocketFloat")
    tree.interface.new_socket("LOD", in_out="INPUT", socket_type="NodeSocketInt")
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

    size = attribute(tree, "size", "FLOAT")
    scale = tree.nodes.new("ShaderNodeMath")
    scale.inputs[1].default_value = 1.0
    tree.links.new(size, scale.inputs[0])

    place = tree.nodes.new("GeometryNodeInstanceOnPoints")
    place.inputs["Pick Instance"].default_value = True
    tree.links.new(entry.outputs["Geometry"], place.inputs["Points"])
    tree.links.new(characters.outputs[0], place.inputs["Instance"])
    tree.links.new(pose, place.inputs["Instance Index"])
    tree.links.new(whole.outputs["Rotation"], place.inputs["Rotation"])
    tree.links.new(scale.outputs["Value"], place.inputs["Scale"])

    level = tree.nodes.new("GeometryNodeStoreNamedAttribute")
    level.data_type = "INT"
    level.domain = "INSTANCE"
    level.inputs["Name"].default_value = "lod"
    tree.links.new(place.outputs["Instances"], level.inputs["Geometry"])
    tree.links.new(entry.outputs["LOD"], level.inputs["Value"])
    tree.links.new(level.outputs["Geometry"], leave.inputs["Geometry"])

    upper = entry, characters, down, stance.node, turn.node, whole, scale, place, level, leave
    spread(upper, (pose.node, heading.node, pitch.node, roll.node, size.node))


def _rotation(tree, **angles: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the rotation of Euler angles in radians."""
    euler = tree.nodes.new("ShaderNodeCombineXYZ")
    rotation = tree.nodes.new("FunctionNodeEulerToRotation")
    for axis, socket in angles.items():
        tree.links.new(socket, euler.inputs[axis])
    tree.links.new(euler.outputs["Vector"], rotation.inputs["Euler"])
    return rotation.outputs["Rotation"]
