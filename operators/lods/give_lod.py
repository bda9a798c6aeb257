"""Give LOD: the selected objects are a LOD of the active object's character."""

from collections.abc import Sequence

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.animation import armatures_of
from ..blender.character_objects import GEOMETRY, may_have_faces
from ..blender.labeled_properties import IntProperty
from ..blender.operator import Reporting
from ..scene.characters.characters import groups_in
from ..scene.characters.given_lods import PROPERTY, CharacterGroup
from ..settings import needs


def give_lod(
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    active: bpy.types.Object | None,
    number: int = 0,
) -> str:
    """Make `objects` the LOD of that `number`, or the next one, of the character of `active`.

    They move to its collection, where they stay as they are. Returns a sentence.
    CrowdError, and nothing has changed, if they cannot be.
    """
    shapes = [item for item in objects if item.type in GEOMETRY and may_have_faces(item)]
    group = _group_of(scene, active)
    lod_objects = [item for item in shapes if item not in group.members]
    if not lod_objects:
        raise CrowdError(
            f"Select the meshes of a LOD, then an object of the character {group.owner.name}."
        )
    if not isinstance(group.owner, bpy.types.Collection):
        raise CrowdError(
            f"The character {group.owner.name} lies in no collection of its own: put it in one, "
            f"inside {scene.crowd_lod.characters.name}."
        )
    if fixed := [item.name for item in lod_objects if item.library or item.override_library]:
        raise CrowdError(f"{', '.join(fixed)}, of another file: name them LOD1 and so on there.")
    number = number or len(group.lods) + 1
    for item in lod_objects:
        item[PROPERTY] = number
    for item in dict.fromkeys([*lod_objects, *armatures_of(lod_objects)]):
        if item not in group.owner.all_objects[:]:
            for home in item.users_collection:
                home.objects.unlink(item)
            group.owner.objects.link(item)
    names = ", ".join(sorted(item.name for item in lod_objects))
    return f"{names}: LOD {number} of {group.owner.name}. Press Make LOD Meshes."


def _group_of(scene: bpy.types.Scene, active: bpy.types.Object | None) -> CharacterGroup:
    for group in groups_in(scene, scene.crowd_lod.characters):
        if active in group.members:
            return group
    raise CrowdError("Make an object of the character the active one: select it last.")


class CROWDLOD_OT_give_lod(Reporting, bpy.types.Operator):
    bl_description = (
        "Use the selected meshes as a LOD of the character selected last; they must stand where it "
        "does"
    )
    bl_idname = "crowd_lod.give_lod"
    bl_label = "Give LOD"
    needs = (needs.characters,)

    level: IntProperty(
        name="LOD", default=0, min=0, max=7, description="Its number; 0 is the next one"
    )

    def run(self, context) -> str:
        return give_lod(context.scene, context.selected_objects, context.object, self.level)


CLASSES = (CROWDLOD_OT_give_lod,)
