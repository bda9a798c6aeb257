"""Take Along: what hangs on a character and lies outside its collection joins it."""

from collections.abc import Iterator

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.messages import Message, MessageKind, from_json, to_json
from ...blender.character_objects import bone_shapes
from ...blender.operator import Reporting
from ...settings import needs
from .character_place import carriers_of, is_shape
from .characters import groups_in
from .characters_from_selection import move_to


def hanging_outside(scene: bpy.types.Scene) -> dict[bpy.types.Object, bpy.types.Collection]:
    """Return what renders show that hangs on a character outside its collection: item -> that."""
    top = scene.crowd_lod.characters
    home_of = {
        item: group.owner
        for group in groups_in(scene, top)
        for item in group.members
        if isinstance(group.owner, bpy.types.Collection)
    }
    left_out = {*top.all_objects, *bone_shapes(scene.objects)}
    outside = [item for item in scene.objects if item not in left_out and is_shape(item)]
    homes = {}
    for item in sorted(outside, key=lambda item: item.name):
        holders = [*carriers_of(item), item.find_armature()]
        home = next((home_of[holder] for holder in holders if holder in home_of), None)
        if home is not None and not item.hide_render:
            homes[item] = home
    return homes


def notes_on_hanging(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on what hangs on characters outside their collections."""
    for item, home in hanging_outside(scene).items():
        facts = {"character": home.name}
        yield Message(MessageKind.HANGS_OUTSIDE, item.name, facts, "crowd_lod.take_along")


class CROWDLOD_OT_take_along(Reporting, bpy.types.Operator):
    """Move objects parented to a character into its collection, so that agents wear them"""

    bl_idname = "crowd_lod.take_along"
    bl_label = "Take Along"
    needs = (needs.characters,)

    def run(self, context) -> str:
        scene = context.scene
        taken = []
        for item, home in hanging_outside(scene).items():
            if home.library or home.override_library:
                raise CrowdError(
                    f"The collection {home.name} is linked from another file, and {item.name} "
                    f"cannot be moved there: add it in that file."
                )
            move_to(item, home, scene)
            taken.append(f"{item.name} (to {home.name})")
        if not taken:
            raise CrowdError("Nothing hangs on a character outside its collection.")
        told = from_json(scene.crowd_lod.trouble)
        others = [message for message in told if message.kind is not MessageKind.HANGS_OUTSIDE]
        scene.crowd_lod.trouble = to_json(others)
        return f"Moved {', '.join(taken)}: press Populate."


CLASSES = (CROWDLOD_OT_take_along,)
