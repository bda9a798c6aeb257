"""What the panels draw with, icons of one color among it."""

import textwrap
from collections.abc import Sequence

import bpy
import bpy.utils.previews

from ..blender import scene_data, steps

SIZE = 16  # pixels
# what a step says while it works
AT_WORK = {
    "crowd_lod.populate": "Populating",
    "crowd_lod.simulate": "Simulating",
    "crowd_lod.record_points": "Recording",
    "crowd_lod.make_levels": "Making LODs",
    "crowd_lod.plan_shot": "Planning",
    "crowd_lod.build": "Building",
    "crowd_lod.bake": "Baking",
    "crowd_lod.estimate": "Estimating",
    "crowd_lod.preview": "Rendering",
    "crowd_lod.verify": "Verifying",
    "crowd_lod.report_error": "Measuring",
    "crowd_lod.export_usd": "Exporting",
    "crowd_lod.write_farm_job": "Writing",
    "crowd_lod.render_viewport": "Rendering",
    "crowd_lod.update_all": "Updating",
}
PROGRESS_WIDTH = 6  # in units of a widget: the longest of them fits, beside the longest title
_icons: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch(color: tuple[float, float, float]) -> int:
    """Return the number of an icon of this color, sRGB, 0 to 1."""
    global _icons
    if _icons is None:
        _icons = bpy.utils.previews.new()
    name = str(tuple(color))
    if name not in _icons:
        icon = _icons.new(name)
        icon.icon_size = SIZE, SIZE
        icon.icon_pixels_float = [*color, 1.0] * SIZE**2
    return _icons[name].icon_id


def unregister() -> None:
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None


MOST_ROWS = 12  # of a table
# Name and icon of each LOD's color in lods.level_objects.TINTS.
LOD_COLORS = (
    ("red", "STRIP_COLOR_01"),
    ("green", "STRIP_COLOR_04"),
    ("blue", "STRIP_COLOR_05"),
    ("orange", "STRIP_COLOR_02"),
    ("sky", "COLORSET_08_VEC"),
    ("yellow", "STRIP_COLOR_03"),
    ("pink", "STRIP_COLOR_07"),
    ("white", "STRIP_COLOR_09"),
    ("purple", "STRIP_COLOR_06"),
    ("brown", "STRIP_COLOR_08"),
)


def label(layout, text: str, icon: str = "NONE") -> None:
    layout.label(text=text, icon=icon, translate=False)


def button(
    layout, name: str, text: str = "", icon: str = "NONE", following: str = ""
) -> bpy.types.OperatorProperties | None:
    """Draw the button of the operator `name`, or its progress while it is at work.

    following: the operator that comes next in the work; its button is drawn as the default one.
    """
    step = steps.at_work()
    if step is not None and step.name == name:
        done = step.slices.progress
        row = layout.row()
        row.ui_units_x = PROGRESS_WIDTH
        row.progress(factor=done, text=f"{AT_WORK[step.doing]}... {done:.0%}", translate=False)
        return None
    row = layout.row(align=True)
    row.active_default = name == following
    if text:
        return row.operator(name, text=text, icon=icon, translate=False)
    return row.operator(name, icon=icon)


def data_block(layout, owner, name: str, **operators: str) -> None:
    """Draw a data-block's menu over the whole width, under its label.

    operators: `new` and `open`.
    """
    label(layout, owner.bl_rna.properties[name].name)
    layout.template_ID(owner, name, **operators)


def report_button(layout, kind: str) -> None:
    """Draw the button, an icon, that opens the report of this kind."""
    layout.operator("crowd_lod.open_report", text="", icon="URL").which = kind


def wide(layout, settings, name: str) -> None:
    """Draw a setting over the whole width, where its label is too long for half of it."""
    row = layout.row()
    row.use_property_split = False
    row.prop(settings, name)


def limit(layout, settings, name: str, text: str) -> None:
    """Draw a limit over the whole width; its label says so where the value 0 is none."""
    row = layout.row()
    row.use_property_split = False
    label_text = text if getattr(settings, name) else f"{text} (No Limit)"
    row.prop(settings, name, text=label_text, translate=False)


def length(context, units: float) -> str:
    return bpy.utils.units.to_string(
        context.scene.unit_settings.system,
        "LENGTH",
        units * scene_data.meters(context.scene),
        precision=3,
    )


def speed(context, way: float, seconds: float) -> str:
    """Return how fast a character travels `way` units in so many seconds; "-" if it does not."""
    return f"{length(context, way / seconds)}/s" if way and seconds else "-"


def distance(context, units: float | None) -> str:
    """Return the distance where a LOD begins as text; "-" for None."""
    if units is None:
        return "-"
    return (
        length(context, units) if abs(units) < float("inf") else "never" if units > 0 else "always"
    )


def table(layout, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    column = layout.column(align=True)  # the text of boxes is hard to read in the light theme
    cells(column, head)
    for row in rows[:MOST_ROWS]:
        cells(column, row)
    if len(rows) > MOST_ROWS:
        label(column, f"and {len(rows) - MOST_ROWS} more")


def cells(layout, texts: Sequence[str], icon: str = "NONE", columns: int = 0) -> bpy.types.UILayout:
    """Draw a row of equal columns, the first of them with these texts, and return it."""
    grid = layout.grid_flow(
        row_major=True, columns=columns or len(texts), even_columns=True, align=True
    )
    for index, text in enumerate(texts):
        label(grid, text, icon if index == 0 else "NONE")
    return grid


def paragraph(layout, sentence: str, icon: str, letters: int) -> None:
    """Draw a sentence, broken into lines of so many letters."""
    column = layout.column(align=True)
    column.alert = icon == "ERROR"
    for index, line in enumerate(textwrap.wrap(sentence, max(20, letters))):
        label(column, line, icon if index == 0 else "BLANK1")


def letters_of(context) -> int:
    """Return how many letters fit in a line of the sidebar, wide ones too."""
    return int(context.region.width / context.preferences.system.ui_scale / 7) - 5
