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
        column = layout.column()
        column.use_property_split = False
        for item in props[:MOST_ROWS]:
            column.prop(item, f'["{PROP}"]', text=item.name, translate=False)
        button(layout, "crowd_lod.make_slot", icon="MOD_CLOTH")
        button(layout, "crowd_lod.mark_as_prop", icon="MOD_CLOTH")


def _draw_slot(layout, title: str, home: bpy.types.Collection) -> None:
    """Draw a row for each part of a slot, for none and for all: its share, and what it excludes."""
    column = layout.column(align=True)
    column.use_property_split = False
    label(column, title, "MOD_CLOTH")
    heads = _cells(column, "Part")
    label(heads, "Share")
    label(heads, "Excludes")
    for part, _ in members_of(home)[:MOST_ROWS]:
        _draw_row(column, part.name, part, SHARE, part)
    _draw_row(column, "None", home, NONE, None)
    if EXCLUDES in home:
        _draw_row(column, "All parts", None, "", home)


def _cells(layout, name: str) -> bpy.types.UILayout:
    """Draw the name that a row begins with; return where its two equal cells go."""
    row = layout.split(factor=0.46, align=True)
    label(row, name)
    return row.grid_flow(row_major=True, columns=2, even_columns=True, align=True)


def _draw_row(layout, name: str, owner: Owner | None, share: str, excluder: Owner | None) -> None:
    """Draw the custom properties `share` of the owner and EXCLUDES of the excluder, if they have
    them.
    """
    row = _cells(layout, name)
    for each, key in ((owner, share), (excluder, EXCLUDES)):
        if each is not None and key in each:
            row.prop(each, f'["{key}"]', text="")
        else:
            label(row, "")


CLASSES = (CROWDLOD_PT_wardrobes,)
