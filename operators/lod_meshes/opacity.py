"""What of a character hides what is behind it: its opaque materials."""

import bpy

from ..blender.shader_nodes import used_nodes

# shaders that light passes, at least in part
CLEAR = {
    "BSDF_TRANSPARENT",
    "BSDF_GLASS",
    "BSDF_REFRACTION",
    "BSDF_TRANSLUCENT",
    "BSDF_HAIR",
    "BSDF_HAIR_PRINCIPLED",
    "HOLDOUT",
    "VOLUME_ABSORPTION",
    "VOLUME_SCATTER",
    "PRINCIPLED_VOLUME",
}
# inputs of a shader that let light pass, and the value of each that lets none
OPAQUE_AT = {"Alpha": 1.0, "Transmission Weight": 0.0}


def hiding_slots(item: bpy.types.Object, evaluated: bpy.types.Object) -> list[bool]:
    """Return for each material slot of an object whether its faces hide what is behind them.

    One value if there is no slot. What the camera does not see hides nothing.
    """
    hides = item.visible_camera
    return [hides and is_opaque(slot.material) for slot in evaluated.material_slots] or [hides]


def is_opaque(material: bpy.types.Material | None) -> bool:
    """Return whether no light passes the material, as far as its nodes tell."""
    if material is None:
        return True
    nodes = used_nodes(material)
    return material.diffuse_color[3] == 1 if nodes is None else not _lets_light_pass(nodes)


def _lets_light_pass(nodes: bpy.types.NodeTree) -> bool:
    for node in nodes.nodes:
        if node.type in CLEAR or (
            node.type == "GROUP" and node.node_tree and _lets_light_pass(node.node_tree)
        ):
            return True
        for name, value in OPAQUE_AT.items():
            socket = node.inputs.get(name) if node.type.startswith("BSDF") else None
            if socket is not None and (
                socket.is_linked or abs(socket.default_value - value) > 1e-3
            ):
                return True
    return False
