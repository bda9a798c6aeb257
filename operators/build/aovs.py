"""Passes of a build for compositing: what the agents are, as AOVs."""

from collections.abc import Iterator

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ..blender.materials import used_nodes
from ..blender.operator import Reporting
from ..settings import needs
from .nodes.agent_aovs import AOVS, agent_aovs
from .shelves import shelves_of
from .visibility import layers_of


def add_aovs(scene: bpy.types.Scene) -> str:
    """Give the view layers that show the build of `scene` the agents' AOVs; return a sentence.

    Materials of its characters get a node that writes them. CrowdError if no material can be
    changed, or a view layer has an AOV of such a name for colors.
    """
    layers = [
        scene.view_layers[name] for name, place in layers_of(scene).items() if not place.exclude
    ]
    if not layers:
        raise CrowdError(
            "No view layer shows the build: switch one on in Render Set-Up > View Layers."
        )
    for layer in layers:
        for aov in layer.aovs:
            if aov.name in AOVS and aov.type != "VALUE":
                raise CrowdError(
                    f"The view layer {layer.name} has an AOV {aov.name} that holds colors: rename "
                    f"it, or remove it."
                )
    if not any(shelf.all_objects for shelf in shelves_of(scene.crowd_lod.build).values()):
        raise CrowdError(
            "The build shows no agents: bake frames in which the camera sees some, then press "
            "Add AOVs again."
        )
    materials = list(materials_of(scene))
    closed = [material for material in materials if not _is_open(material)]
    if len(closed) == len(materials):
        raise CrowdError(
            "No material of the characters can be changed: give them materials with nodes, or "
            "press Make Library Override for linked ones."
        )
    for material in materials:
        if material not in closed:
            _write_aovs(material)
    for layer in layers:
        for name in sorted(AOVS.difference(aov.name for aov in layer.aovs)):
            aov = layer.aovs.add()
            aov.name = name
            aov.type = "VALUE"
    sentences = [
        f"{', '.join(sorted(AOVS))} are AOVs of {counted(len(layers), 'view layer')}, written by "
        f"{counted(len(materials) - len(closed), 'material')}."
    ]
    if closed:
        names = ", ".join(material.name for material in closed)
        sentences.append(f"Linked, or without nodes, and left out: {names}.")
    return " ".join(sentences)


def materials_of(scene: bpy.types.Scene) -> Iterator[bpy.types.Material]:
    """Yield each material of the characters that the build of `scene` shows, once."""
    past_materials = set()
    for shelf in shelves_of(scene.crowd_lod.build).values():
        for item in shelf.all_objects:
            for slot in item.material_slots:
                if slot.material is not None and slot.material not in past_materials:
                    past_materials.add(slot.material)
                    yield slot.material


def _is_open(material: bpy.types.Material) -> bool:
    return material.is_editable and used_nodes(material) is not None


def _write_aovs(material: bpy.types.Material) -> None:
    """Give the material a node that writes the AOVs, unless it has one."""
    group = agent_aovs()
    nodes = material.node_tree.nodes
    if not any(getattr(node, "node_tree", None) == group for node in nodes):
        node = nodes.new("ShaderNodeGroup")
        node.node_tree = group
        left = min(other.location.x for other in nodes)
        below = min(other.location.y for other in nodes)
        node.location = (left, below - 300)


class CROWDLOD_OT_add_aovs(Reporting, bpy.types.Operator):
    """Give id, looks, group and LOD of the agents to the compositor, as AOVs"""

    bl_idname = "crowd_lod.add_aovs"
    bl_label = "Add AOVs"
    needs = (needs.build,)

    def run(self, context) -> str:
        return add_aovs(context.scene)


CLASSES = (CROWDLOD_OT_add_aovs,)
