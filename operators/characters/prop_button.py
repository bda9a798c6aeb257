"""Mark as Prop: only some of a group's agents have the selected objects."""

from collections.abc import Sequence

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.labeled_properties import FloatProperty
from ..blender.operator import Reporting
from ..blender.props import PROP
from ..settings import needs
from .characters import all_characters, groups_in


def props_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the props of all character groups of `scene`, sorted by name."""
    top = scene.crowd_lod.characters
    members = (
        {item for group in groups_in(scene, top) for item in group.members if PROP in item}
        if top is not None
        else set()
    )
    return sorted(members, key=lambda item: item.name.casefold())


def mark(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], chance: float) -> None:
    """Mark `objects` as props that agents have by `chance`.

    CrowdError, and nothing is marked, if one cannot be.
    """
    before = {item: item.get(PROP) for item in objects}
    try:
        for item in objects:
            item[PROP] = chance
            item.id_properties_ui(PROP).update(
                min=0.0, max=1.0, description="Chance that an agent has this prop"
            )
        all_characters(scene)
    except CrowdError:
        for item, value in before.items():
            if value is None:
                del item[PROP]
            else:
                item[PROP] = value
        raise


class CROWDLOD_OT_mark_as_prop(Reporting, bpy.types.Operator):
    bl_description = (
        "Let only some agents have the selected objects of character groups, and what is "
        "parented to them"
    )
    bl_idname = "crowd_lod.mark_as_prop"
    bl_label = "Mark as Prop"
    needs = (needs.characters,)

    chance: FloatProperty(
        name="Chance",
        default=0.5,
        min=0,
        max=1,
        subtype="FACTOR",
        description="That an agent has the prop; with 1 all have it",
    )

    def run(self, context) -> str:
        scene = context.scene
        members = {
            item for group in groups_in(scene, scene.crowd_lod.characters) for item in group.members
        }
        props = [
            item for item in context.selected_objects if item in members and item.library is None
        ]
        if not props:
            raise CrowdError(
                "Select an object of a character group first: one that only some of its agents "
                "are to have."
            )
        mark(scene, props, round(self.chance, 6))
        names = ", ".join(sorted(item.name for item in props))
        return f"{self.chance:.0%} of the agents will have {names}: press Populate."


CLASSES = (CROWDLOD_OT_mark_as_prop,)
