"""Whether surfaces let light through: read from their materials' nodes."""

import bpy

from .shader_nodes import used_nodes

# shaders that let no ray through; the inputs of others decide, or they do let some through
OPAQUE = {
    "BACKGROUND",
    "BSDF_DIFFUSE",
    "BSDF_GLOSSY",
    "BSDF_METALLIC",
    "BSDF_SHEEN",
    "BSDF_TOON",
    "BSDF_TRANSLUCENT",
    "EEVEE_SPECULAR",
    "EMISSION",
    "SUBSURFACE_SCATTERING",
}
MIXES = {"MIX_SHADER", "ADD_SHADER", "REROUTE"}


def is_opaque(material: bpy.types.Material | None) -> bool:
    """Return whether no ray of a camera gets through the material, where its surface is seen.

    What its outputs get decides: a node that leads to none does not count.
    """
    if material is None:
        return True
    tree = used_nodes(material)
    if tree is None:
        return material.diffuse_color[3] == 1
    outputs = _outputs(tree)
    return bool(outputs) and all(_blocks(node.inputs["Surface"]) for node in outputs)


def hides_in_all_engines(material: bpy.types.Material | None) -> bool:
    """Return whether a surface of the material hides what is behind it, in any engine and frame.

    Materials that are animated, that move their surface or that show one side alone do not.
    """
    if material is None:
        return True
    tree = used_nodes(material)
    if (
        material.use_backface_culling
        or material.diffuse_color[3] < 1
        or material.animation_data
        or (tree is not None and tree.animation_data)
    ):
        return False
    inputs = ["Volume"] if material.displacement_method == "BUMP" else ["Volume", "Displacement"]
    outputs = _outputs(tree) if tree is not None else []
    is_linked = any(node.inputs[name].is_linked for node in outputs for name in inputs)
    return not is_linked and is_opaque(material)


def _outputs(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    return [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL" and not node.mute]


def _blocks(socket: bpy.types.NodeSocket) -> bool:
    """Return whether the shader, or the color that shines, that `socket` gets lets no ray
    through.
    """
    links = [link for link in socket.links if not link.is_muted]
    if len(links) != 1:
        return False
    return links[0].from_socket.type != "SHADER" or _node_blocks(links[0].from_node)


def _node_blocks(node: bpy.types.Node) -> bool:
    if node.mute:
        return False
    if node.type == "BSDF_PRINCIPLED":
        alpha = node.inputs["Alpha"]
        transmission = node.inputs["Transmission Weight"]
        return not (
            alpha.is_linked
            or alpha.default_value < 1
            or transmission.is_linked
            or transmission.default_value > 0
        )
    if node.type in MIXES:
        shaders = [socket for socket in node.inputs if socket.type == "SHADER"]
        return bool(shaders) and all(map(_blocks, shaders))
    if node.type == "GROUP" and node.node_tree is not None and not node.node_tree.animation_data:
        ends = [end for end in node.node_tree.nodes if end.type == "GROUP_OUTPUT"]
        shaders = [socket for end in ends for socket in end.inputs if socket.type == "SHADER"]
        return bool(shaders) and all(map(_blocks, shaders))
    return node.type in OPAQUE
