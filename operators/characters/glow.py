"""Characters that glow: in Cycles their light reaches the picture from wherever they are."""

from collections.abc import Iterator

import bpy

from ...crowd_lod.messages import Message, MessageKind
from ..blender.materials import emits
from .characters import characters_of

# rays that meet light
LIT_BY = (
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
)


def glowing(scene: bpy.types.Scene) -> dict[str, list[bpy.types.Material]]:
    """Return the materials that light others, of each character group that wears any."""
    lights_by_group = {}
    for name, objects, _ in characters_of(scene):
        worn = {
            slot.material
            for item in objects
            if any(getattr(item, ray) for ray in LIT_BY)
            for slot in item.material_slots
        }
        lights = [material for material in worn - {None} if emits(material.node_tree)]
        if lights:
            lights_by_group[name] = sorted(lights, key=lambda material: material.name_full)
    return lights_by_group


def notes_on_glow(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters whose materials light others."""
    for name, materials in glowing(scene).items():
        facts = {"material": materials[0].name, "stays": scene.crowd_lod.shadows}
        yield Message(MessageKind.GLOWS, name, facts)
