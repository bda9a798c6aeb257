"""The node group that puts a LOD's character collections on a bucket's points."""

import bpy

NAME = "Crowd LOD Instances"
VERSION = 1


def instances() -> bpy.types.GeometryNodeTree:
    """The group of this version: points with heading (radians) and group (index) in, collection instances out.

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

    heading = _attribute(tree, "heading", "FLOAT")
    group = _attribute(tree, "group", "INT")
    angle = tree.nodes.new("ShaderNodeMath")
    angle.operation = "ADD"
    tree.links.new(heading, angle.inputs[0])
    tree.links.new(entry.outputs["Turn"], angle.inputs[1])
    euler = tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(angle.outputs["Value"], euler.inputs["Z"])

    place = tree.nodes.new("GeometryNodeInstanceOnPoints")
    place.inputs["Pick Instance"].default_value = True
    tree.links.new(entry.outputs["Geometry"], place.inputs["Points"])
    tree.links.new(characters.outputs[0], place.inputs["Instance"])
    tree.links.new(group, place.inputs["Instance Index"])
    tree.links.new(euler.outputs["Vector"], place.inputs["Rotation"])
    tree.links.new(place.outputs["Instances"], leave.inputs["Geometry"])

    for column, node in enumerate((entry, characters, group.node, heading.node, angle, euler, place, leave)):
        node.location = (180 * column, 0 if node not in (heading.node, group.node) else -200)


def _attribute(tree, name: str, kind: str) -> bpy.types.NodeSocket:
    node = tree.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(s for s in node.outputs if s.enabled and s.name == "Attribute")
