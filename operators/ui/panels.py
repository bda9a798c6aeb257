"""The panels of the crowd and its LODs, a step of the work each. They only draw.

Their height does not change while one works: figures and messages are in popovers and in the
viewport; what does not apply is grayed.
"""

from textwrap import shorten

import bpy

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.format import counted
from ...crowd_lod.levels.cost_model import NAMES
from ..blender.scene_data import engine_of
from ..deliver.update_all import due_steps
from ..freshness.artifacts import LODS, stale
from ..settings import needs
from ..settings.crowds import active_crowd
from ..settings.level_settings import CrowdLodGroup
from ..viewport import viewport_overlay
from . import steps
from .action_menu import draw_action
from .agent_overrides import draw_agent_overrides
from .crowd_list import (
    MOVERS,
    OfCrowd,
    draw_behavior,
    draw_ground,
    draw_source,
    parts_shown,
)
from .drawing import (
    LOD_COLORS,
    MOST_ROWS,
    active_column,
    button,
    cells,
    label,
    length,
    letters_of,
    limit,
    speed,
    table,
    wide,
)
from .goal_list import draw_simulation
from .settings_list import draw_list
from .step_panel import Sidebar, StepPanel, help_button
from .wardrobe_panel import CROWDLOD_PT_wardrobes


class CROWDLOD_PT_main(Sidebar, bpy.types.Panel):
    bl_label = "Crowd LOD"

    def draw_header_preset(self, context) -> None:
        row = self.layout.row()
        row.emboss = "NONE"
        row.popover("CROWDLOD_PT_presets", text="", icon="PRESET")
        help_button(self.layout, "The sidebar")

    def draw(self, context) -> None:
        column = self.layout.column(align=True)
        scene = context.scene
        row = column.row(align=True)
        row.prop(scene.crowd_lod, "overlay", text="", icon="OVERLAY")
        row.popover("CROWDLOD_PT_statistics", text=_line(scene), translate=False)
        (sentence, icon, _), *others = steps.messages(scene)
        warnings = sum(other.icon == "ERROR" for other in others)
        # An error needs all the room: Blender cuts the middle of a long line. The popover has all.
        more = f" ({counted(warnings, 'warning')})" if warnings and icon != "ERROR" else ""
        sentence = (
            shorten(sentence, max(20, letters_of(context) - len(more)), placeholder="...") + more
        )
        row = column.row(align=True)
        row.alert = icon == "ERROR"
        row.popover("CROWDLOD_PT_messages", text=sentence, icon=icon, translate=False)
        _update_row(column, scene)


def _update_row(layout, scene: bpy.types.Scene) -> None:
    """Draw the button that does all steps which are due; gray where none is."""
    row = layout.row()
    text = "Update All"
    if not (needs.crowd(scene) or needs.camera(scene)):
        due = due_steps(scene)
        words = {"Make LOD Meshes": "Make", "Plan Shot": "Plan"}
        names = ", ".join(words.get(step, step) for step in due)
        row.enabled = bool(due)
        text = f"Update All: {names}" if due else "All is up to date"
    button(row, "crowd_lod.update_all", text, "FILE_REFRESH", steps.next_operator(scene))


def _line(scene: bpy.types.Scene) -> str:
    """Return the frame's figures in one line."""
    frame = viewport_overlay.latest(scene)
    if frame is None:
        return "Statistics: overlay off" if not scene.crowd_lod.overlay else "Statistics"
    visible = len(frame.without_worn(frame.buckets).order)
    counts = f"{visible:,} of {frame.people:,} visible"
    return (
        f"{counts}, {frame.triangles / frame.full_triangles:.0%} triangles"
        if frame.full_triangles
        else counts
    )


class CROWDLOD_PT_crowd(StepPanel, bpy.types.Panel):
    bl_label = "Crowd"
    bl_options = set()

    def draw_header_preset(self, context) -> None:
        following = steps.next_operator(context.scene)
        if context.scene.crowd_lod.characters is None:
            button(
                self.layout,
                "crowd_lod.characters_from_selection",
                "Selection",
                following=following,
            )
        else:
            button(self.layout, "crowd_lod.populate", "Populate", following=following)
        self.draw_help()

    def body(self, context, layout, settings) -> None:
        following = steps.next_operator(context.scene)
        draw_list(layout, settings, "crowd", settings, rows=2)
        crowd = active_crowd(settings)
        if crowd is not None:
            draw_source(layout, crowd)
        layout.prop(settings, "characters")
        button(
            layout,
            "crowd_lod.characters_from_selection",
            icon="RESTRICT_SELECT_OFF",
            following=following,
        )
        layout.prop(settings, "forward")
        button(layout, "crowd_lod.populate", icon="OUTLINER_OB_POINTCLOUD", following=following)


class CROWDLOD_PT_groups(StepPanel, bpy.types.Panel):
    bl_label = "Character Groups"
    bl_parent_id = "CROWDLOD_PT_crowd"

    @classmethod
    def poll(cls, context) -> bool:
        return len(context.scene.crowd_lod.groups) > 0

    def body(self, context, layout, settings) -> None:
        groups = [group for group in settings.groups if not group.variant_of]
        rows = [
            (
                group.name,
                length(context, group.radius),
                length(context, group.stride) if group.stride else "by time",
                speed(context, group.stride or group.way, group.period),
            )
            for group in groups
        ]
        table(layout, ("Group", "Radius", "Stride", "Speed"), rows)
        kinds = CrowdLodGroup.bl_rna.properties["plays"].enum_items
        for group in [group for group in groups if group.way and not group.stride][:MOST_ROWS]:
            label(layout, f"{group.name}: {kinds[group.plays].description}", "INFO")
        for group in groups[:MOST_ROWS]:
            draw_action(layout, context.scene, group)
        for group in groups[:MOST_ROWS] if len(groups) > 1 else ():
            layout.prop(group, "share", text=f"{group.name} Share", translate=False)
        crowd = active_crowd(settings)
        if crowd is not None:
            layout.prop(crowd, "group_names")


class CROWDLOD_PT_crowd_advanced(StepPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_crowd"

    def body(self, context, layout, settings) -> None:
        groups = [group for group in settings.groups if not group.variant_of]
        for group in groups[:MOST_ROWS]:
            layout.row().prop(group, "scale", text=f"{group.name} Scale", translate=False)
        for group in [group for group in groups if group.lowest][:MOST_ROWS]:
            layout.prop(group, "on_ground", text=f"{group.name} on Ground", translate=False)
        button(layout, "crowd_lod.give_lod", icon="MOD_DECIM")
        button(layout, "crowd_lod.take_action", icon="ACTION")


class CROWDLOD_PT_behavior(OfCrowd, bpy.types.Panel):
    bl_label = "Behavior"

    def crowd(self, context, layout, crowd) -> None:
        draw_behavior(layout, crowd)
        layout.menu("CROWDLOD_MT_machine_presets", icon="PRESET")
        parts = parts_shown(context.scene)
        machine = parts[-1].machine if parts and isinstance(parts[-1], Walk) else None
        about = (
            f"{counted(len(machine.states), 'state')}, {counted(len(machine.labels), 'label')}; "
            f"edge: {machine.edge}"
            if machine
            else "-"
        )
        label(layout, MOVERS.get(crowd.source, about), "INFO")


class CROWDLOD_PT_behavior_advanced(OfCrowd, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_behavior"

    def crowd(self, context, layout, crowd) -> None:
        active_column(layout, crowd.source != "POINTS").prop(crowd, "first_frame")


class CROWDLOD_PT_heights(OfCrowd, bpy.types.Panel):
    bl_label = "Ground"
    bl_parent_id = "CROWDLOD_PT_behavior"

    def crowd(self, context, layout, crowd) -> None:
        draw_ground(layout, crowd)


class CROWDLOD_PT_simulation(OfCrowd, bpy.types.Panel):
    bl_label = "Simulation"
    bl_parent_id = "CROWDLOD_PT_behavior"

    @classmethod
    def poll(cls, context) -> bool:
        crowd = active_crowd(context.scene.crowd_lod)
        return crowd is not None and crowd.source == "SIMULATION"

    def crowd(self, context, layout, crowd) -> None:
        draw_simulation(layout, context, crowd)


class CROWDLOD_PT_camera(StepPanel, bpy.types.Panel):
    bl_label = "Camera"

    def body(self, context, layout, settings) -> None:
        layout.prop(context.scene, "camera", text="Active Camera", translate=False)
        wide(layout, settings, "shadows")
        column = active_column(layout, settings.shadows)
        wide(column, settings, "sky_light")
        column.prop(settings, "mirrors")


class CROWDLOD_PT_culling(StepPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_camera"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "margin_kind")
        active_column(layout, settings.margin_kind == "FIXED").prop(
            settings, "margin", text="Distance", translate=False
        )
        wide(layout, settings, "occlusion")
        active_column(layout, settings.occlusion).prop(settings, "occlusion_exclude")


class CROWDLOD_PT_levels(StepPanel, bpy.types.Panel):
    bl_label = "LOD Meshes"
    main = ("crowd_lod.make_levels", "Make")

    def body(self, context, layout, settings) -> None:
        row = layout.row()
        row.use_property_split = False
        row.prop(settings, "choice", expand=True)
        if settings.choice == "BY_TOLERANCE":
            layout.prop(settings, "tolerance")
            limit(layout, settings, "memory", "Memory, MB")
        else:
            layout.prop(settings, "level_count")
            self.ratios(context, layout, settings)
        button(
            layout,
            "crowd_lod.make_levels",
            icon="MOD_DECIM",
            following=steps.next_operator(context.scene),
        )
        self.draw_made(context, layout, settings)

    def draw_made(self, context, layout, settings) -> None:
        """Draw what has changed since LODs were made, and a line on those of each group."""
        line = letters_of(context)
        since = [str(change) for change in stale(context.scene, LODS)]
        sentence = "Press Make LOD Meshes" if settings.levels is None else "LOD meshes are made"
        if since:
            sentence = f"Changed: {', '.join(since)}"
        label(
            layout, shorten(sentence, line, placeholder="..."), "FILE_REFRESH" if since else "INFO"
        )
        without = (
            f"no LOD pays in {NAMES[engine_of(context.scene)]}"
            if settings.choice == "BY_TOLERANCE"
            else "no LODs"
        )
        for group in settings.groups[: MOST_ROWS if settings.levels is not None else 0]:
            label(layout, shorten(_lods_of(group, without), line, placeholder="..."), "MESH_DATA")

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


def _lods_of(group, without: str) -> str:
    """Return a line on the LODs of a group with their triangles; `without` if it has none."""
    counts = [*dict.fromkeys(count for count in group.triangles if count)][1:]
    if not counts:
        return f"{group.name}: full mesh, {without}"
    return (
        f"{group.name}: {counted(len(counts), 'LOD')}: "
        f"{', '.join(f'{count:,}' for count in counts)} triangles"
    )


class CROWDLOD_PT_custom_thresholds(StepPanel, bpy.types.Panel):
    bl_label = "Thresholds of Groups"
    bl_parent_id = "CROWDLOD_PT_levels"

    @classmethod
    def poll(cls, context) -> bool:
        settings = context.scene.crowd_lod
        return (
            settings.choice == "BY_DISTANCE"
            and settings.level_count > 1
            and len(settings.groups) > 0
        )

    def body(self, context, layout, settings) -> None:
        layout.use_property_split = False
        for group in [group for group in settings.groups if not group.variant_of][:MOST_ROWS]:
            layout.prop(group, "use_custom_thresholds", text=group.name, translate=False)
            row = layout.row(align=True)
            row.active = group.use_custom_thresholds
            for level in range(settings.level_count - 1):
                row.prop(group, "thresholds", index=level, text="")


class CROWDLOD_PT_decimation(StepPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_levels"

    def body(self, context, layout, settings) -> None:
        active_column(layout, settings.choice == "BY_TOLERANCE").prop(settings, "match_shading")
        layout.prop(settings, "bias_image")


class CROWDLOD_PT_overlay(StepPanel, bpy.types.Panel):
    bl_label = "Overlay"

    def draw_header(self, context) -> None:
        self.layout.prop(context.scene.crowd_lod, "overlay", text="")

    def body(self, context, layout, settings) -> None:
        column = active_column(layout, settings.overlay)
        for name in (
            "overlay_camera",
            "overlay_mode",
            "overlay_color",
            "overlay_culled",
            "hud",
            "inset",
        ):
            column.prop(settings, name)
        row = column.row(align=True)
        row.prop(settings, "agent")
        row.operator("crowd_lod.inspect", text="", icon="EYEDROPPER")
        draw_agent_overrides(column)
        column.operator("crowd_lod.render_viewport", icon="RENDER_STILL")


CLASSES = (
    CROWDLOD_PT_main,
    CROWDLOD_PT_crowd,
    CROWDLOD_PT_groups,
    CROWDLOD_PT_wardrobes,
    CROWDLOD_PT_crowd_advanced,
    CROWDLOD_PT_behavior,
    CROWDLOD_PT_behavior_advanced,
    CROWDLOD_PT_heights,
    CROWDLOD_PT_simulation,
    CROWDLOD_PT_camera,
    CROWDLOD_PT_culling,
    CROWDLOD_PT_levels,
    CROWDLOD_PT_custom_thresholds,
    CROWDLOD_PT_decimation,
    CROWDLOD_PT_overlay,
)
