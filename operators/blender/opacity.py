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
    "EMISSION",
    "SUBSURFACE_SCATTERING",
}
MIXES = {"MIX_SHADER", "ADD_SHADER", "REROUTE"}


def is_opaque(material: bpy.types.Material | None) -> bool:
    """Return whether no ray of a camera gets through a surface of the material, in any engine.

    Materials that are animated, that move their surface or that show one side alone do not count
    as opaque.
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
    if tree is None:
        return True
    outputs = [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL" and not node.mute]
    bumps = material.displacement_method == "BUMP"
    return bool(outputs) and all(
        not node.inputs["Volume"].is_linked
        and (bumps or not node.inputs["Displacement"].is_linked)
        and _blocks(node.inputs["Surface"])
        for node in outputs
    )


def _blocks(socket: bpy.types.NodeSocket) -> bool:
    """Return whether the shader that `socket` gets lets no ray through."""
    links = [link for link in socket.links if not link.is_muted]
    return len(links) == 1 and _node_blocks(links[0].from_node)


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
