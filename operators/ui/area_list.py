"""Walls and areas of the active crowd: their list in the sidebar, and its buttons."""

import bpy

from ...crowd_lod.format import counted
from ..blender.character_objects import selected_scenery
from ..blender.operator import Reporting
from ..scene.machine import map_areas
from ..scene.machine.machine_editor import draft_of, selected_name
from ..settings.crowds import active_crowd, active_or_new
from .settings_list import Moving, OfActiveCrowd, Removing, SwitchedRow, draw_list


class CROWDLOD_UL_areas(SwitchedRow, bpy.types.UIList):
    """One area a row: its switch, its name and its label."""

    @staticmethod
    def words(item) -> str:
        return item.label


def _some(scene: bpy.types.Scene) -> str:
    crowd = active_crowd(scene.crowd_lod)
    return "" if crowd is not None and len(crowd.areas) else "There are no walls and areas"


class CROWDLOD_OT_add_area(Reporting, bpy.types.Operator):
    bl_description = (
        "Lay a label where the selected objects are; without a selection, choose an object or "
        "collection later"
    )
    bl_idname = "crowd_lod.add_area"
    bl_label = "Add Wall or Area"

    def run(self, context) -> str:
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


class _OfAreas(OfActiveCrowd):
    """What the buttons of the list share."""

    kind = "area"
    needs = (_some,)

    def changed(self, scene: bpy.types.Scene) -> None:
        map_areas.follow_soon(scene)


class CROWDLOD_OT_remove_area(_OfAreas, Removing, bpy.types.Operator):
    """Remove the selected area; the map is then as it was painted there"""

    bl_idname = "crowd_lod.remove_area"
    bl_label = "Remove Wall or Area"


class CROWDLOD_OT_move_area(_OfAreas, Moving, bpy.types.Operator):
    """Move the selected area: of two at the same place, the lower one counts"""

    bl_idname = "crowd_lod.move_area"
    bl_label = "Move Wall or Area"


class CROWDLOD_OT_refresh_areas(Reporting, bpy.types.Operator):
    """Lay the labels of walls and areas anew, as their objects stand now"""

    bl_idname = "crowd_lod.refresh_areas"
    bl_label = "Refresh Walls and Areas"
    needs = (_some,)

    def run(self, context) -> str:
        crowd = active_crowd(context.scene.crowd_lod)
        cells = map_areas.make(crowd, context.evaluated_depsgraph_get())
        return (
            f"{counted(cells, 'cell of the map lies', 'cells of the map lie')} under walls and "
            f"areas."
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
    layout.operator("crowd_lod.refresh_areas", icon="FILE_REFRESH")


CLASSES = (
    CROWDLOD_UL_areas,
    CROWDLOD_OT_add_area,
    CROWDLOD_OT_remove_area,
    CROWDLOD_OT_move_area,
    CROWDLOD_OT_refresh_areas,
)
