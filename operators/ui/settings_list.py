"""Lists of the settings in the sidebar, such as the overrides."""

from collections.abc import Callable
from dataclasses import dataclass

import bpy

from ...crowd_lod.errors import CrowdError
from ..settings.crowds import active_crowd


@dataclass(frozen=True)
class SettingsList:
    """A list of the settings.

    kind: what a row is, such as "override"; the rows are then called `overrides`, and the selected
        one's index `override_index`.
    tells: what its buttons do, by "add", "remove" and "move".
    append: adds rows, selects the last of them, and returns a sentence.
    of_crowd: whether the active crowd has the rows, and the editor the index; else both are of the
        scene's settings.
    changed: follows a change of the list.
    """

    kind: str
    tells: dict[str, str]
    append: Callable[[bpy.types.Context], str]
    of_crowd: bool = False
    changed: Callable[[bpy.types.Scene], None] = lambda _: None

    def add(self, context, copy: bool) -> str:
        if copy:
            raise CrowdError(f"A row of {self.kind}s cannot be copied: add one.")
        return self.append(context)

    def remove(self, scene: bpy.types.Scene) -> str:
        rows = self._rows(scene)
        index = self._selected(scene)
        name = rows[index].name
        rows.remove(index)
        self._select(scene, max(index - 1, 0))
        self.changed(scene)
        return f"Removed {name}."

    def move(self, scene: bpy.types.Scene, by: int) -> str:
        rows = self._rows(scene)
        index = self._selected(scene)
        to = min(max(index + by, 0), len(rows) - 1)
        rows.move(index, to)
        self._select(scene, to)
        self.changed(scene)
        return f"Moved {rows[to].name} to place {to + 1}."

    def _rows(self, scene: bpy.types.Scene) -> bpy.types.bpy_prop_collection:
        owner = active_crowd(scene.crowd_lod) if self.of_crowd else scene.crowd_lod
        rows = getattr(owner, f"{self.kind}s", ())
        if not len(rows):
            raise CrowdError(f"There is no {self.kind}.")
        return rows

    def _holder(self, scene: bpy.types.Scene) -> bpy.types.PropertyGroup:
        return scene.crowd_lod_editor if self.of_crowd else scene.crowd_lod

    def _selected(self, scene: bpy.types.Scene) -> int:
        index = getattr(self._holder(scene), f"{self.kind}_index")
        return min(index, len(self._rows(scene)) - 1)

    def _select(self, scene: bpy.types.Scene, index: int) -> None:
        setattr(self._holder(scene), f"{self.kind}_index", index)


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
    kind, holder: see SettingsList.
    rows: that are shown; below four the buttons that move rows have no room.
    """
    row = layout.row()
    row.use_property_split = False
    row.template_list(
        f"CROWDLOD_UL_{kind}s", "", owner, f"{kind}s", holder, f"{kind}_index", rows=rows
    )
    is_filled = len(getattr(owner, f"{kind}s")) > 0
    draw_row_buttons(row, f"{kind}s", is_filled, moves=rows >= 4)


def draw_row_buttons(
    layout, kind: str, is_filled: bool, moves: bool = True, copies: bool = False
) -> None:
    """Draw the buttons that add, copy, remove and move the rows of a list; see list_buttons.py."""
    column = layout.column(align=True)
    column.operator("crowd_lod.add_row", text="", icon="ADD").kind = kind
    rest = column.column(align=True)
    rest.enabled = is_filled
    rest.operator("crowd_lod.remove_row", text="", icon="REMOVE").kind = kind
    if copies:
        copy = rest.operator("crowd_lod.add_row", text="", icon="DUPLICATE")
        copy.kind = kind
        copy.copy = True
    for by, icon in ((-1, "TRIA_UP"), (1, "TRIA_DOWN")) if moves else ():
        move = rest.operator("crowd_lod.move_row", text="", icon=icon)
        move.kind = kind
        move.by = by
