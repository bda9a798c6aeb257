"""The panel of the shot: its frames, camera and plan; and its sub-panels."""

from math import ceil

import bpy

from ...crowd_lod.shot.budget import budget_sentence, fitting_point, least_possible
from ..blender import scene_data
from ..freshness.artifacts import PLAN, reason_in, stale, words_of
from ..scene.plan_verdict import stored_verdict
from ..scene.sources.crowd_overrides import CROWD_TYPES
from ..settings.stored_figures import LIMITS, budget_of, possible_budgets
from ..viewport import viewport_overlay
from .drawing import letters_of, limit, paragraph, report_button, wide
from .settings_list import draw_list
from .step_panel import StepPanel


class CROWDLOD_PT_shot(StepPanel, bpy.types.Panel):
    bl_label = "Shot"

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        return "crowd_lod.plan_shot", "Plan"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "frames", placeholder=scene_data.range_of(context.scene))
        layout.prop(context.scene, "camera", text="Camera", translate=False)
        layout.prop(settings, "output_folder")
        wide(layout, settings, "pop_reduction_percent")
        if settings.shot_plan:
            _draw_plan(context, layout, settings)


def _draw_plan(context, layout, settings) -> None:
    """Draw whether the plan is in use, its verdict, and what shows more of it."""
    row = layout.row(align=True)
    row.use_property_split = False
    row.prop(settings, "use_shot_plan", toggle=True)
    report_button(row, "PLAN")
    paragraph(layout, *describe_hold(context.scene), letters_of(context))
    if verdict := stored_verdict(settings):
        paragraph(layout, verdict.sentence, "HIDE_OFF", letters_of(context))
        if verdict.notable:
            layout.operator("crowd_lod.go_to_switch", icon="VIEWZOOM")
    if possible_budgets(settings):
        layout.popover(
            "CROWDLOD_PT_error_curve",
            text="Error Against Cost",
            icon="IPO_LINEAR",
            translate=False,
        )


def describe_hold(scene: bpy.types.Scene) -> tuple[str, str]:
    """Return (whether the stored plan holds, in the frame that the overlay shows too, its icon)."""
    if not scene.crowd_lod.shot_plan:
        return "No plan: LODs by distance", "INFO"
    if not scene.crowd_lod.use_shot_plan:
        return "Plan switched off", "INFO"
    frame = viewport_overlay.latest(scene)
    changed = reason_in(words_of(stale(scene, PLAN)))
    if changed or frame is not None and frame.unplanned:
        return f"Outdated{': ' * bool(changed)}{changed}. Plan again.", "ERROR"
    if frame is None or frame.planned:
        return "Plan up to date", "CHECKMARK"
    return "The plan is for the scene's camera", "INFO"


class CROWDLOD_PT_culling(StepPanel, bpy.types.Panel):
    bl_label = "Culling"
    bl_parent_id = "CROWDLOD_PT_shot"

    def body(self, context, layout, settings) -> None:
        wide(layout, settings, "shadows")
        if settings.shadows:
            wide(layout, settings, "sky_light")
            layout.prop(settings, "mirrors")
        wide(layout, settings, "occlusion")
        if settings.occlusion:
            layout.prop(settings, "occlusion_exclude")
        layout.prop(settings, "margin_kind")
        if settings.margin_kind == "FIXED":
            layout.prop(settings, "margin", text="Distance", translate=False)


class CROWDLOD_PT_budget(StepPanel, bpy.types.Panel):
    bl_label = "Budget"
    bl_parent_id = "CROWDLOD_PT_shot"

    def body(self, context, layout, settings) -> None:
        for setting, text, _ in LIMITS.values():
            limit(layout, settings, setting, text)
        points = possible_budgets(settings)
        budget = budget_of(settings)
        if sentence := budget_sentence(points, budget):
            fits = fitting_point(points, budget) is not None
            paragraph(layout, sentence, "CHECKMARK" if fits else "ERROR", letters_of(context))
            for name, value in least_possible(points, budget).items() if not fits else ():
                _draw_least(layout, name, value)


def _draw_least(layout, name: str, value: float) -> None:
    """Draw the button that raises a limit to the least possible value."""
    setting, title, unit = LIMITS[name]
    least = ceil(value / unit)
    kind = "float" if name == "memory" else "int"
    button = layout.operator(
        f"wm.context_set_{kind}", text=f"{title}: {least:,}", icon="FORWARD", translate=False
    )
    button.data_path = f"scene.crowd_lod.{setting}"
    button.value = least


class CROWDLOD_PT_overrides(StepPanel, bpy.types.Panel):
    bl_label = "Overrides"
    bl_parent_id = "CROWDLOD_PT_shot"

    def body(self, context, layout, settings) -> None:
        draw_list(layout, settings, "override", settings)
        layout.operator("crowd_lod.erase", icon="SELECT_SUBTRACT")
        if settings.override_index < len(settings.overrides):
            self.entry(layout, settings.overrides[settings.override_index])

    def entry(self, layout, entry) -> None:
        """Draw the settings of the selected override: what, who, when, a row each."""
        column = layout.column()
        column.active = entry.use
        column.use_property_split = False
        row = column.row(align=True)
        row.prop(entry, "type", text="")
        if entry.type == "GROUP":
            row.prop_search(entry, "group_name", entry.id_data.crowd_lod, "groups", text="")
        elif entry.type == "NUDGE":
            column.row().prop(entry, "move", text="")
        elif entry.type != "HIDE":
            row.prop(entry, "level")
        row = column.row(align=True)
        row.prop(entry, "select_by", text="")
        row.prop(entry, "region" if entry.select_by == "REGION" else "agents", text="")
        if entry.select_by != "NUMBERS":
            row.operator("crowd_lod.find_agents", text="", icon="VIEWZOOM")
        if entry.type in CROWD_TYPES:  # they hold in all frames
            return
        column.prop(entry, "all_frames")
        if not entry.all_frames:
            row = column.row(align=True)
            row.prop(entry, "first_frame", text="First", translate=False)
            row.prop(entry, "last_frame", text="Last", translate=False)


CLASSES = (
    CROWDLOD_PT_shot,
    CROWDLOD_PT_culling,
    CROWDLOD_PT_budget,
    CROWDLOD_PT_overrides,
)
