"""The buttons of all lists in the sidebar: add a row, remove it, move it."""

import bpy

from ..blender.labeled_properties import BoolProperty, EnumProperty, IntProperty
from ..blender.operator import Reporting
from ..scene.machine.machine_lists import LABELS, STATES
from .area_list import AREAS
from .crowd_list import CROWDS
from .goal_list import GOALS
from .override_list import OVERRIDES

LISTS = {
    "crowds": CROWDS,
    "goals": GOALS,
    "areas": AREAS,
    "states": STATES,
    "labels": LABELS,
    "overrides": OVERRIDES,
}


def _choice(description: str) -> bpy.types.EnumProperty:
    items = [(name, name.capitalize(), "") for name in LISTS]
    return EnumProperty(name="List", items=items, description=description)


class CROWDLOD_OT_add_row(Reporting, bpy.types.Operator):
    """Add a row to a list of the sidebar"""

    bl_idname = "crowd_lod.add_row"
    bl_label = "Add Row"

    kind: _choice("The list that gets a row")
    copy: BoolProperty(name="Copy", description="Copy the selected state or label, with its rules")

    @classmethod
    def description(cls, context, properties) -> str:
        if properties.copy:
            return properties.bl_rna.properties["copy"].description
        return LISTS[properties.kind].tells["add"]

    def run(self, context) -> str:
        return LISTS[self.kind].add(context, self.copy)


class CROWDLOD_OT_remove_row(Reporting, bpy.types.Operator):
    """Remove the selected row of a list of the sidebar"""

    bl_idname = "crowd_lod.remove_row"
    bl_label = "Remove Row"

    kind: _choice("The list that loses its selected row")

    @classmethod
    def description(cls, context, properties) -> str:
        return LISTS[properties.kind].tells["remove"]

    def run(self, context) -> str:
        return LISTS[self.kind].remove(context.scene)


class CROWDLOD_OT_move_row(Reporting, bpy.types.Operator):
    """Move the selected row of a list of the sidebar"""

    bl_idname = "crowd_lod.move_row"
    bl_label = "Move Row"

    kind: _choice("The list whose selected row moves")
    by: IntProperty(name="By", description="Rows down; up below 0", default=1)

    @classmethod
    def description(cls, context, properties) -> str:
        return LISTS[properties.kind].tells["move"]

    def run(self, context) -> str:
        return LISTS[self.kind].move(context.scene, self.by)


CLASSES = (CROWDLOD_OT_add_row, CROWDLOD_OT_remove_row, CROWDLOD_OT_move_row)
