"""The menu in which a character group is given an action of the file."""

import bpy

from ..blender.labeled_properties import CONTEXT
from ..scene.characters.action_choice import fits_of
from ..scene.characters.motionless import STANDS_STILL, owner_of, rig_of
from .drawing import label
from .group_list import selected_group

MOST_ACTIONS = 40  # in a menu


def draw_action(layout, scene: bpy.types.Scene, group: bpy.types.PropertyGroup) -> None:
    """Draw a menu with the action that the selected group's rig plays; nothing without a rig."""
    rig = _rig(scene, group)
    if rig is None:
        return
    data = rig.animation_data
    plays = data.action.name if data is not None and data.action is not None else "No Action"
    if plays == "No Action" and owner_of(scene, group.name).get(STANDS_STILL):
        plays = "Stands Still"
    row = layout.split(factor=0.4)
    name = row.row()
    name.alignment = "RIGHT"
    label(name, "Action")
    row.menu("CROWDLOD_MT_action", text=plays, icon="ACTION", translate=False)


def _rig(scene: bpy.types.Scene, group: bpy.types.PropertyGroup) -> bpy.types.Object | None:
    """Return the group's rig; None without one, or where the group is gone."""
    top = scene.crowd_lod.characters
    is_there = top is not None and (group.name in top.children or group.name in top.objects)
    return rig_of(scene, group.name) if is_there else None


class CROWDLOD_MT_action(bpy.types.Menu):
    """Actions of the file that move the selected group's bones, walks first"""

    bl_label = "Action"
    bl_translation_context = CONTEXT

    @classmethod
    def poll(cls, context) -> bool:
        scene = context.scene
        return bool(len(scene.crowd_lod.groups)) and _rig(scene, selected_group(scene)) is not None

    def draw(self, context) -> None:
        group = selected_group(context.scene).name
        rig = rig_of(context.scene, group)
        for fit in fits_of(rig)[:MOST_ACTIONS]:
            row = self.layout.row()
            row.enabled = not fit.misfits
            how = " (turned over)" if fit.turned else ""
            how = f" (of {fit.source.name})" if fit.misfits else how
            text = f"{fit.action.name}{how}"
            chosen = row.operator(
                "crowd_lod.take_action", text=text, icon="ACTION", translate=False
            )
            chosen.group, chosen.action = group, fit.action.name
        self.layout.separator()
        still = self.layout.operator("crowd_lod.take_action", text="Stand Still", translate=False)
        still.group = group
        still.still = True


CLASSES = (CROWDLOD_MT_action,)
