"""The panel of the LODs, and its sub-panels."""

from textwrap import shorten

import bpy

from ...crowd_lod.levels.cost_model import NAMES
from ..blender.scene_data import engine_of
from ..freshness.artifacts import LODS, stale
from ..viewport.hud import short
from .drawing import LOD_COLORS, MOST_ROWS, cells, label, length, letters_of, limit
from .group_list import draw_groups
from .step_panel import StepPanel


class CROWDLOD_PT_levels(StepPanel, bpy.types.Panel):
    bl_label = "LODs"

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        return "crowd_lod.make_levels", "Make"

    def body(self, context, layout, settings) -> None:
        row = layout.row()
        row.use_property_split = False
        row.prop(settings, "choice", expand=True)
        if settings.choice == "BY_TOLERANCE":
            layout.prop(settings, "tolerance")
            limit(layout, settings, "memory", "Character Memory, MB")
        self.draw_made(context, layout, settings)

    def draw_made(self, context, layout, settings) -> None:
        """Draw what has changed since LODs were made, and a row on those of each group."""
        line = letters_of(context)
        if since := [str(change) for change in stale(context.scene, LODS)]:
            sentence = f"Changed: {', '.join(since)}"
            label(layout, shorten(sentence, line, placeholder="..."), "FILE_REFRESH")
        if settings.levels is None:
            label(layout, "No LODs yet", "INFO")
            return
        without = (
            f"no LOD pays in {NAMES[engine_of(context.scene)]}"
            if settings.choice == "BY_TOLERANCE"
            else "full mesh only"
        )
        column = layout.column(align=True)
        label(column, "Triangles of each LOD")
        for group in settings.groups[:MOST_ROWS]:
            row = column.split(factor=0.35)
            label(row, group.name, "MESH_DATA")
            label(row, _triangles_of(group) or without)


def _triangles_of(group: bpy.types.PropertyGroup) -> str:
    """Return the triangles of a group's LODs, the finest first; "" if it has none."""
    counts = [*dict.fromkeys(count for count in group.triangles if count)]
    return " > ".join(map(short, counts)) if counts[1:] else ""


class CROWDLOD_PT_by_distance(StepPanel, bpy.types.Panel):
    bl_label = "By Distance"
    bl_parent_id = "CROWDLOD_PT_levels"

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene.crowd_lod.choice == "BY_DISTANCE"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "level_count")
        self.ratios(context, layout, settings)
        if settings.level_count > 1 and len(settings.groups):
            group = draw_groups(layout, context.scene)
            layout.prop(group, "use_custom_thresholds")
            if group.use_custom_thresholds:
                column = layout.column(align=True)
                for level in range(1, settings.level_count):
                    column.prop(
                        group, "thresholds", index=level - 1, text=f"LOD {level}", translate=False
                    )

    def ratios(self, context, layout, settings) -> None:
        """Draw, for each LOD, the settings of what it keeps and where it begins."""
        camera = context.scene.camera
        far = camera.data.clip_end if camera is not None and camera.type == "CAMERA" else None
        grid = layout.column(align=True)
        grid.use_property_split = False
        cells(grid, ("LOD", "Ratio", "From", "Distance"))
        for level in range(settings.level_count):
            row = cells(grid, (str(level),), icon=LOD_COLORS[level][1], columns=4)
            row.prop(settings, "ratios", index=level, text="")
            if level == 0:
                label(row, "near")
                label(row, "")
            else:
                row.prop(settings, "thresholds", index=level - 1, text="")
                label(row, length(context, far * settings.thresholds[level - 1]) if far else "?")


class CROWDLOD_PT_levels_advanced(StepPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_levels"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "bias_image")


CLASSES = (
    CROWDLOD_PT_levels,
    CROWDLOD_PT_by_distance,
    CROWDLOD_PT_levels_advanced,
)
