"""The menu in which a character group is given an action of the file."""

import bpy

from ..blender.labeled_properties import CONTEXT
from ..scene.characters.action_choice import fits_of
from ..scene.characters.motionless import STANDS_STILL, owner_of, rig_of
from .drawing import label

MOST_ACTIONS = 40  # in a menu
GROUP = "crowd_lod_group"  # in the context, the group whose menu is drawn


def draw_action(layout, scene: bpy.types.Scene, group: bpy.types.PropertyGroup) -> None:
    """Draw a menu with the action that a group's rig plays; nothing without a rig."""
    rig = rig_of(scene, group.name) if _is_there(scene, group.name) else None
    if rig is None:
        return
    data = rig.animation_data
    plays = data.action.name if data is not None and data.action is not None else "No Action"
    if plays == "No Action" and owner_of(scene, group.name).get(STANDS_STILL):
        plays = "Stands Still"
    row = layout.row(align=True)
    row.context_pointer_set(GROUP, group)
    label(row, group.name)
    row.menu("CROWDLOD_MT_action", text=plays, icon="ACTION", translate=False)


def _is_there(scene: bpy.types.Scene, name: str) -> bool:
    top = scene.crowd_lod.characters
    return top is not None and (name in top.children or name in top.objects)


class CROWDLOD_MT_action(bpy.types.Menu):
    """Actions of the file that move this group's bones, walks first"""

    bl_label = "Action"
    bl_translation_context = CONTEXT

    @classmethod
    def poll(cls, context) -> bool:
        return getattr(context, GROUP, None) is not None

    def draw(self, context) -> None:
        group = getattr(context, GROUP).name
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
        self.layout.operator("crowd_lod.stand_still").group = group


CLASSES = (CROWDLOD_MT_action,)
