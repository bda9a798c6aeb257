"""Walls and areas of the active crowd: their list in the sidebar."""

import bpy

from ...crowd_lod.format import counted
from ..blender.character_objects import selected_scenery
from ..scene.machine import map_areas
from ..scene.machine.machine_editor import draft_of, selected_name
from ..settings.crowds import active_or_new
from .settings_list import SettingsList, SwitchedRow, draw_list


class CROWDLOD_UL_areas(SwitchedRow, bpy.types.UIList):
    """One area a row: its switch, its name and its label."""

    @staticmethod
    def words(item) -> str:
        return item.label


def _add(context) -> str:
    scene = context.scene
    crowd = active_or_new(scene.crowd_lod)
    labels = map_areas.machine_of(crowd).labels
    label = "wall" if "wall" in labels else selected_name(scene, "labels") or labels[-1]
    items = selected_scenery(context)
    for item in items or [None]:
        entry = crowd.areas.add()
        entry.name = item.name if item else "Area"
        entry.object = item
        entry.label = label
    scene.crowd_lod_editor.area_index = len(crowd.areas) - 1
    if not items:
        return "Choose an object or a collection for the area."
    cells = map_areas.make(crowd, context.evaluated_depsgraph_get())
    lie = counted(cells, "cell of the map lies", "cells of the map lie")
    return f"{', '.join(item.name for item in items)}: {label}; {lie} under areas."


AREAS = SettingsList(
    "area",
    {
        "add": "Lay a label where the selected objects are; without a selection, choose an object "
        "or collection later",
        "remove": "Remove the selected area; the map shows again what is painted there",
        "move": "Move the selected area: of two at the same place, the lower one counts",
    },
    _add,
    of_crowd=True,
    changed=map_areas.follow_soon,
)


def draw_areas(layout, context, crowd) -> None:
    """Draw the list of the crowd's walls and areas, and the settings of the selected one."""
    editor = context.scene.crowd_lod_editor
    draw_list(layout, crowd, "area", editor)
    layout.operator("crowd_lod.walls_from_selection", icon="MOD_BUILD")
    if not len(crowd.areas):
        return
    entry = crowd.areas[min(editor.area_index, len(crowd.areas) - 1)]
    column = layout.column()
    column.active = entry.use
    column.prop(entry, "object")
    column.prop(entry, "collection")
    row = column.row()
    row.alert = entry.label not in draft_of(context.scene).labels and crowd.machine is not None
    row.prop_search(entry, "label", context.window_manager.crowd_lod_rows, "labels")


CLASSES = (CROWDLOD_UL_areas,)
