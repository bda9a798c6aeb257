"""The shader node group that writes what the agents are to AOVs."""

import bpy

from .trees import current, spread

NAME = "Crowd LOD AOVs"
VERSION = 1
AOVS = frozenset(("id", "looks", "group", "lod"))  # attributes of instances, and names of AOVs


def agent_aovs() -> bpy.types.ShaderNodeTree:
    """Return the node group that writes the attributes AOVS of an instance to AOVs of their names.

    It has no inputs and no outputs: it works in every material that holds it.
    """
    return current(NAME, VERSION, _wire, "ShaderNodeTree")


def _wire(tree: bpy.types.ShaderNodeTree) -> None:
    for name in sorted(AOVS):
        attribute = tree.nodes.new("ShaderNodeAttribute")
        attribute.attribute_type = "INSTANCER"
        attribute.attribute_name = name
        aov = tree.nodes.new("ShaderNodeOutputAOV")
        aov.aov_name = name
        tree.links.new(attribute.outputs["Fac"], aov.inputs["Value"])
    nodes = list(tree.nodes)
    spread(*zip(nodes[::2], nodes[1::2], strict=True))
