"""Lists of the settings in the sidebar, such as the overrides, and their buttons."""

import bpy

from ..blender.labeled_properties import IntProperty
from ..blender.operator import Reporting
from ..settings.crowds import active_crowd


class Listed(Reporting):
    """Mix-in for a button of a list.

    kind: what a row is, such as "override". Then the scene's settings have the rows as
        `overrides`, if `rows` does not say otherwise, and what `holder` returns has the selected
        row's index as `override_index`.
    """

    kind = ""

    @staticmethod
    def holder(scene: bpy.types.Scene) -> bpy.types.PropertyGroup:
        return scene.crowd_lod

    def changed(self, scene: bpy.types.Scene) -> None:
        """Follow a change of the list."""

    def rows(self, scene: bpy.types.Scene) -> bpy.types.bpy_prop_collection:
        return getattr(scene.crowd_lod, f"{self.kind}s")

    def selected(self, scene: bpy.types.Scene) -> int:
        return min(getattr(self.holder(scene), f"{self.kind}_index"), len(self.rows(scene)) - 1)

    def select(self, scene: bpy.types.Scene, index: int) -> None:
        setattr(self.holder(scene), f"{self.kind}_index", index)


class OfActiveCrowd:
    """Mix-in, before the others, for a button of a list that the active crowd has."""

    kind = ""

    @staticmethod
    def holder(scene: bpy.types.Scene) -> bpy.types.PropertyGroup:
        return scene.crowd_lod_editor

    def rows(self, scene: bpy.types.Scene) -> bpy.types.bpy_prop_collection:
        return getattr(active_crowd(scene.crowd_lod), f"{self.kind}s")


class Removing(Listed):
    """Mix-in for the button that removes the selected row."""

    def run(self, context) -> str:
        scene = context.scene
        index = self.selected(context.scene)
        name = self.rows(scene)[index].name
        self.rows(scene).remove(index)
        self.select(scene, max(index - 1, 0))
        self.changed(scene)
        return f"{name} is removed."


class Moving(Listed):
    """Mix-in for the button that moves the selected row."""

    by: IntProperty(name="By", description="Rows down; up below 0", default=1)

    def run(self, context) -> str:
        scene = context.scene
        index = self.selected(context.scene)
        to = min(max(index + self.by, 0), len(self.rows(scene)) - 1)
        self.rows(scene).move(index, to)
        self.select(scene, to)
        self.changed(scene)
        return f"{self.rows(scene)[to].name} is at place {to + 1}."


class SwitchedRow:
    """A list whose rows have a switch, a name, and the few words that `words(item)` returns."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "use", text="")
        part = row.row(align=True)
        part.active = item.use
        part.prop(item, "name", text="", emboss=False)
        part.label(text=self.words(item), translate=False)


def draw_list(layout, owner, kind: str, holder: bpy.types.PropertyGroup, rows: int = 4) -> None:
    """Draw a list and its buttons.

    owner: of the rows, the scene's settings or a crowd.
    kind, holder: see Listed.
    rows: that are shown; below four the buttons that move rows have no room.
    """
    row = layout.row()
    row.use_property_split = False
    row.template_list(
        f"CROWDLOD_UL_{kind}s", "", owner, f"{kind}s", holder, f"{kind}_index", rows=rows
    )
    column = row.column(align=True)
    for work, icon in (("add", "ADD"), ("remove", "REMOVE")):
        column.operator(f"crowd_lod.{work}_{kind}", text="", icon=icon)
    for by, icon in ((-1, "TRIA_UP"), (1, "TRIA_DOWN")) if rows >= 4 else ():
        column.operator(f"crowd_lod.move_{kind}", text="", icon=icon).by = by
