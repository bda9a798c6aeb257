"""The panel of what only some agents of a group wear: slots with their parts, and props."""

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.character_objects import PROP
from ..scene.characters.characters import groups_in
from ..scene.characters.wardrobe import EXCLUDES, NONE, SHARE, Owner, members_of, slots_in
from ..scene.characters.wardrobe_buttons import props_in
from .drawing import MOST_ROWS, button, label, letters_of, paragraph
from .step_panel import StepPanel


class CROWDLOD_PT_wardrobes(StepPanel, bpy.types.Panel):
    bl_label = "Wardrobes"
    bl_parent_id = "CROWDLOD_PT_crowd"

    def body(self, context, layout, settings) -> None:
        groups = groups_in(context.scene, settings.characters) if settings.characters else ()
        for group in groups:
            try:
                slots = slots_in(group.owner)
            except CrowdError as error:
                paragraph(layout, str(error), "ERROR", letters_of(context))
                continue
            for name, home in slots.items():
                _draw_slot(layout, f"{name} of {group.owner.name}", home)
        props = props_in(context.scene)
        if props:
            label(layout, "Chance of Props")
        for item in props[:MOST_ROWS]:
            layout.prop(item, f'["{PROP}"]', text=item.name, translate=False)
        button(layout, "crowd_lod.make_slot", icon="MOD_CLOTH")
        button(layout, "crowd_lod.mark_as_prop", icon="MOD_CLOTH")


def _draw_slot(layout, title: str, home: bpy.types.Collection) -> None:
    """Draw the shares of a slot's parts and of none, and what they exclude."""
    column = layout.column(align=True)
    row = column.row(align=True)
    label(row, title, "MOD_CLOTH")
    _draw_value(row, home, EXCLUDES, "")
    for part, _ in members_of(home)[:MOST_ROWS]:
        row = column.row(align=True)
        _draw_value(row, part, SHARE, part.name)
        _draw_value(row, part, EXCLUDES, "")
    _draw_value(column, home, NONE, "None")


def _draw_value(row, owner: Owner, name: str, text: str) -> None:
    """Draw a custom property of a slot or a part; its text alone where it has none."""
    if name in owner:
        icon = "X" if name == EXCLUDES else "NONE"
        row.prop(owner, f'["{name}"]', text=text, icon=icon, translate=False)
    elif text:
        label(row, text)


CLASSES = (CROWDLOD_PT_wardrobes,)
