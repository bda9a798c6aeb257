"""Whether lamps and materials give light to others: read from their nodes."""

import bpy

from .shader_nodes import used_nodes


def casts(lamp: bpy.types.Light) -> bool:
    """Return whether the lamp is on and casts shadows."""
    return lamp.use_shadow and lamp.energy != 0 and any(lamp.color) and not _dark(used_nodes(lamp))


def _dark(tree: bpy.types.NodeTree | None) -> bool:
    """Return whether all emission nodes of a lamp have strength 0."""
    emissions = [node for node in tree.nodes if node.type == "EMISSION"] if tree is not None else []
    return bool(emissions) and not any(_set(node.inputs["Strength"]) for node in emissions)


def emits(tree: bpy.types.NodeTree | None) -> bool:
    """Return whether a material's nodes emit light that other surfaces receive.

    Emission for camera rays alone does not count: "unlit" materials have it, glTF's among them.
    """
    ends = {"OUTPUT_MATERIAL", "GROUP_OUTPUT"}
    sockets = [
        socket
        for node in (tree.nodes if tree is not None else ())
        if node.type in ends
        for socket in node.inputs
    ]
    visited: set[bpy.types.Node] = set()
    while sockets:
        socket = sockets.pop()
        for link in socket.links:
            node = link.from_node
            if socket.type == "SHADER" and link.from_socket.type != "SHADER":
                return True  # a color that is no shader shows as emission
            if node not in visited:
                visited.add(node)
                if _emits_itself(node):
                    return True
                sockets += _seen_by_all(node)
    return False


def _emits_itself(node: bpy.types.Node) -> bool:
    if node.mute:
        return False
    if node.type == "GROUP":
        return emits(node.node_tree)
    if node.type in ("EMISSION", "BACKGROUND"):
        return (
            _set(node.inputs["Color"])
            and _set(node.inputs["Strength"])
            and not _of_camera(node.inputs["Strength"])
        )
    if node.type in ("BSDF_PRINCIPLED", "PRINCIPLED_VOLUME"):
        strength = node.inputs["Emission Strength"]
        return _set(strength) and _set(node.inputs["Emission Color"]) and not _of_camera(strength)
    return False


def _seen_by_all(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the inputs of `node` that other rays than the camera's may meet."""
    inputs = list(node.inputs)
    return (
        inputs[:2]
        if node.type == "MIX_SHADER" and not node.mute and _of_camera(inputs[0])
        else inputs
    )


def _of_camera(socket: bpy.types.NodeSocket) -> bool:
    """Return whether `socket` is 1 for camera rays and 0 for all others."""
    return any(
        link.from_node.type == "LIGHT_PATH" and link.from_socket.name == "Is Camera Ray"
        for link in socket.links
    )


def _set(socket: bpy.types.NodeSocket) -> bool:
    """Return whether a strength or color may differ from 0."""
    value = socket.default_value
    return socket.is_linked or (any(value[:3]) if hasattr(value, "__len__") else value != 0)
