"""Walls and areas: their settings, their list in the sidebar, and its buttons."""

import bpy

from ..blender.labelled_properties import BoolProperty, IntProperty, PointerProperty, StringProperty
from ..blender.operator import Reporting
from ..crowd import map_areas
from ..crowd.machine_editor import draft_of, selected


def _follow(entry, context) -> None:
    map_areas.follow_soon(entry.id_data)


class CrowdLodArea(bpy.types.PropertyGroup):
    """Meshes that lay a label over the label map, called `name`."""

    use: BoolProperty(update=_follow, name="Use", default=True, description="The label lies over the map")
    object: PointerProperty(
        update=_follow,
        type=bpy.types.Object,
        name="Object",
        poll=lambda _, candidate: map_areas.is_scenery(candidate),
        description="The label lies where this object is, seen from above",
    )
    collection: PointerProperty(
        update=_follow,
        type=bpy.types.Collection,
        name="Collection",
        description="The label lies where these objects are, seen from above",
    )
    label: StringProperty(update=_follow, name="Label", description="Label that lies over the map")


class CROWDLOD_UL_areas(bpy.types.UIList):
    """One area a row: its switch, its name and its label."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "use", text="")
        part = row.row(align=True)
        part.active = item.use
        part.prop(item, "name", text="", emboss=False)
        part.label(text=item.label, translate=False)


def _some(scene: bpy.types.Scene) -> str:
    return "" if len(scene.crowd_lod.areas) else "There are no walls and areas"


class CROWDLOD_OT_add_area(Reporting, bpy.types.Operator):
    """Lay a label where the selected objects are; without a selection, choose an object or collection later"""

    bl_idname = "crowd_lod.add_area"
    bl_label = "Add Wall or Area"

    def run(self, context) -> str:
        scene, settings = context.scene, context.scene.crowd_lod
        labels = map_areas.machine_of(settings).labels
        label = "wall" if "wall" in labels else selected(scene, "labels") or labels[-1]
        items = [item for item in context.selected_objects if map_areas.is_scenery(item)]
        for item in items or [None]:
            entry = settings.areas.add()
            entry.name, entry.object, entry.label = item.name if item else "Area", item, label
        scene.crowd_lod_editor.area_index = len(settings.areas) - 1
        if not items:
            return "Choose an object or a collection for the area."
        cells = map_areas.make(settings, context.evaluated_depsgraph_get())
        return f"{', '.join(item.name for item in items)}: {label}; {cells:,} cells of the map lie under areas."


class CROWDLOD_OT_remove_area(Reporting, bpy.types.Operator):
    """Remove the selected area; the map is then as it was painted there"""

    bl_idname = "crowd_lod.remove_area"
    bl_label = "Remove Wall or Area"
    needs = (_some,)

    def run(self, context) -> str:
        settings, editor = context.scene.crowd_lod, context.scene.crowd_lod_editor
        index = min(editor.area_index, len(settings.areas) - 1)
        name = settings.areas[index].name
        settings.areas.remove(index)
        editor.area_index = max(index - 1, 0)
        map_areas.follow_soon(context.scene)
        return f"{name} is removed."


class CROWDLOD_OT_move_area(Reporting, bpy.types.Operator):
    """Move the selected area: of two at the same place, the lower one counts"""

    bl_idname = "crowd_lod.move_area"
    bl_label = "Move Wall or Area"
    needs = (_some,)

    by: IntProperty(name="By", description="Rows down; up below 0", default=1)

    def run(self, context) -> str:
        settings, editor = context.scene.crowd_lod, context.scene.crowd_lod_editor
        last = len(settings.areas) - 1
        index = min(editor.area_index, last)
        editor.area_index = to = min(max(index + self.by, 0), last)
        settings.areas.move(index, to)
        map_areas.follow_soon(context.scene)
        return f"{settings.areas[to].name} is at place {to + 1}."


class CROWDLOD_OT_refresh_areas(Reporting, bpy.types.Operator):
    """Lay the labels of walls and areas anew, as their objects stand now"""

    bl_idname = "crowd_lod.refresh_areas"
    bl_label = "Refresh Walls and Areas"
    needs = (_some,)

    def run(self, context) -> str:
        cells = map_areas.make(context.scene.crowd_lod, context.evaluated_depsgraph_get())
        return f"{cells:,} cells of the map lie under walls and areas."


def draw_areas(layout, context, settings) -> None:
    """Draw the list of walls and areas, and the settings of the selected one."""
    editor = context.scene.crowd_lod_editor
    row = layout.row()
    row.use_property_split = False
    row.template_list("CROWDLOD_UL_areas", "", settings, "areas", editor, "area_index", rows=4)
    column = row.column(align=True)
    column.operator("crowd_lod.add_area", text="", icon="ADD")
    column.operator("crowd_lod.remove_area", text="", icon="REMOVE")
    for by, icon in ((-1, "TRIA_UP"), (1, "TRIA_DOWN")):
        column.operator("crowd_lod.move_area", text="", icon=icon).by = by
    if not len(settings.areas):
        return
    entry = settings.areas[min(editor.area_index, len(settings.areas) - 1)]
    column = layout.column()
    column.active = entry.use
    column.prop(entry, "object")
    column.prop(entry, "collection")
    row = column.row()
    row.alert = entry.label not in draft_of(context.scene).labels and settings.machine is not None
    row.prop_search(entry, "label", context.window_manager.crowd_lod_rows, "labels")
    layout.operator("crowd_lod.refresh_areas", icon="FILE_REFRESH")


CLASSES = (
    CrowdLodArea,
    CROWDLOD_UL_areas,
    CROWDLOD_OT_add_area,
    CROWDLOD_OT_remove_area,
    CROWDLOD_OT_move_area,
    CROWDLOD_OT_refresh_areas,
)
