"""The node group that puts a LOD's character collections on a bucket's points."""

import bpy

NAME = "Crowd LOD Instances"
VERSION = 2


def instances() -> bpy.types.GeometryNodeTree:
    """The group of this version: points with heading, pitch, roll (radians) and group (index) in, collection instances
    out, turned by Rz(heading) Ry(-pitch) Rx(roll) Rz(Turn). Points without pitch and roll stand upright.

    Inputs: Geometry, Characters (a collection with one child a character group, in natural order of names), Turn
    (radians about z that turn a character to +x). A group of another version is rebuilt in place, so that files saved
    with it follow.
    """
    tree = bpy.data.node_groups.get(NAME)
    if tree is not None and tree.bl_idname == "GeometryNodeTree" and tree.get("version") == VERSION:
        return tree
    if tree is None or tree.bl_idname != "GeometryNodeTree":
        tree = bpy.data.node_groups.new(NAME, "GeometryNodeTree")
    tree.nodes.clear()
    tree.interface.clear()
    _wire(tree)
    tree["version"] = VERSION
    return tree


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

    heading, pitch, roll = (_attribute(tree, name, "FLOAT") for name in ("heading", "pitch", "roll"))
    group = _attribute(tree, "group", "INT")
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

    place = tree.nodes.new("GeometryNodeInstanceOnPoints")
    place.inputs["Pick Instance"].default_value = True
    tree.links.new(entry.outputs["Geometry"], place.inputs["Points"])
    tree.links.new(characters.outputs[0], place.inputs["Instance"])
    tree.links.new(group, place.inputs["Instance Index"])
    tree.links.new(whole.outputs["Rotation"], place.inputs["Rotation"])
    tree.links.new(place.outputs["Instances"], leave.inputs["Geometry"])

    upper = entry, characters, down, stance.node, turn.node, whole, place, leave
    for row, nodes in enumerate((upper, (group.node, heading.node, pitch.node, roll.node))):
        for column, node in enumerate(nodes):
            node.location = (180 * column, -200 * row)


def _rotation(tree, **angles: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The rotation of Euler angles in radians."""
    euler, rotation = tree.nodes.new("ShaderNodeCombineXYZ"), tree.nodes.new("FunctionNodeEulerToRotation")
    for axis, socket in angles.items():
        tree.links.new(socket, euler.inputs[axis])
    tree.links.new(euler.outputs["Vector"], rotation.inputs["Euler"])
    return rotation.outputs["Rotation"]


def _attribute(tree, name: str, kind: str) -> bpy.types.NodeSocket:
    node = tree.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(s for s in node.outputs if s.enabled and s.name == "Attribute")
