"""The panels of the shot: its plan, preview, build and proof. They only draw."""

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size, counted
from ...crowd_lod.levels.cost_model import NAMES, SEEN
from ...crowd_lod.shot.budget import budget_sentence, fitting_point
from ..blender import scene_data
from ..build.character_images import IMAGE_BYTES, can_use_cache
from ..build.render_setup import baked_of
from ..build.visibility import layers_of
from ..deliver.hand_over import Lack, lacks_of, sizes_of
from ..deliver.usd.openusd import missing_openusd
from ..freshness.artifacts import BAKE, build_artifact, stale
from ..freshness.bake_frames import is_bake
from ..scene.plan_verdict import verdict_in_words
from ..scene.sources.crowd_overrides import CROWD_TYPES
from ..settings import needs
from ..settings.stored_figures import LIMITS, budget_of, costs_of, possible_budgets
from ..viewport import viewport_overlay
from . import steps
from .drawing import active_column, button, label, letters_of, limit, paragraph, wide
from .settings_list import draw_list
from .step_panel import StepPanel


class CROWDLOD_PT_plan(StepPanel, bpy.types.Panel):
    bl_label = "Plan Shot"
    main = ("crowd_lod.plan_shot", "Plan")

    def body(self, context, layout, settings) -> None:
        wide(layout, settings, "pop_reduction_percent")
        _with_report(
            layout, "crowd_lod.plan_shot", "TIME", "PLAN", steps.next_operator(context.scene)
        )
        row = layout.row()
        row.use_property_split = False
        row.enabled = bool(settings.shot_plan)
        row.prop(settings, "use_shot_plan", toggle=True)
        if verdict := verdict_in_words(settings):
            paragraph(layout, verdict, "HIDE_OFF", letters_of(context))
        layout.operator("crowd_lod.go_to_switch", icon="VIEWZOOM")
        label(layout, *describe_hold(context.scene))


def _with_report(layout, name: str, icon: str, report: str, following: str) -> bpy.types.UILayout:
    """Draw the button of a step, and beside it the one that opens its report; return the row."""
    row = layout.row(align=True)
    button(row, name, icon=icon, following=following)
    row.operator("crowd_lod.open_report", text="", icon="URL").which = report
    return row


def describe_hold(scene: bpy.types.Scene) -> tuple[str, str]:
    """Return (whether the stored plan holds in the frame that the overlay shows, its icon)."""
    if not scene.crowd_lod.shot_plan:
        return "No plan: LODs by distance", "INFO"
    frame = viewport_overlay.latest(scene) if scene.crowd_lod.use_shot_plan else None
    if frame is None:
        return (
            "Switched off"
            if not scene.crowd_lod.use_shot_plan
            else "The overlay tells if it holds",
            "INFO",
        )
    if frame.planned:
        return f"Frame {frame.time:g} is as planned", "CHECKMARK"
    return (
        ("Does not hold: see above", "ERROR")
        if frame.unplanned
        else ("The viewport's view has no plan", "INFO")
    )


class CROWDLOD_PT_budget(StepPanel, bpy.types.Panel):
    bl_label = "Budget"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        for setting, text, _ in LIMITS.values():
            limit(layout, settings, setting, text)
        _possible_budgets(context, layout, settings)


def _possible_budgets(context, layout, settings) -> None:
    """Draw whether the planned shot can keep the budget, and the button of the curve."""
    points = possible_budgets(settings)
    budget = budget_of(settings)
    if sentence := budget_sentence(points, budget):
        icon = "CHECKMARK" if fitting_point(points, budget) else "ERROR"
        paragraph(layout, sentence, icon, letters_of(context))
    row = layout.row()
    row.enabled = bool(points)
    row.popover(
        "CROWDLOD_PT_error_curve", text="Error Against Cost", icon="IPO_LINEAR", translate=False
    )


class CROWDLOD_PT_overrides(StepPanel, bpy.types.Panel):
    bl_label = "Overrides"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        draw_list(layout, settings, "override", settings)
        layout.operator("crowd_lod.add_agent_override", icon="EYEDROPPER")
        layout.operator("crowd_lod.erase", icon="SELECT_SUBTRACT")
        if settings.override_index < len(settings.overrides):
            self.entry(layout, settings.overrides[settings.override_index])

    def entry(self, layout, entry) -> None:
        """Draw the settings of the selected override."""
        column = active_column(layout, entry.use)
        column.prop(entry, "type")
        if entry.type == "GROUP":
            column.prop_search(entry, "group_name", entry.id_data.crowd_lod, "groups")
        elif entry.type == "NUDGE":
            column.prop(entry, "move")
        else:
            active_column(column, entry.type != "HIDE").prop(entry, "level")
        column.prop(entry, "select_by")
        column.prop(entry, "region" if entry.select_by == "REGION" else "agents")
        by_place = active_column(column, entry.select_by != "NUMBERS")
        by_place.operator("crowd_lod.find_agents", icon="VIEWZOOM")
        span = active_column(column, entry.type not in CROWD_TYPES)
        span.prop(entry, "all_frames")
        frames = active_column(span, not entry.all_frames)
        frames.prop(entry, "first_frame")
        frames.prop(entry, "last_frame")


class CROWDLOD_PT_plan_output(StepPanel, bpy.types.Panel):
    bl_label = "Frames and Output"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "frames", placeholder=scene_data.range_of(context.scene))
        layout.prop(settings, "output_folder")
        layout.prop(settings, "shot_plan")


class CROWDLOD_PT_preview(StepPanel, bpy.types.Panel):
    bl_label = "Preview"
    main = ("crowd_lod.preview", "Preview")

    def body(self, context, layout, settings) -> None:
        for name in ("step", "width"):
            layout.prop(settings, name)
        _with_report(layout, "crowd_lod.preview", "RENDER_ANIMATION", "PREVIEW", "")


class CROWDLOD_PT_build(StepPanel, bpy.types.Panel):
    bl_label = "Build"

    def draw_header_preset(self, context) -> None:
        artifact = build_artifact(context.scene)
        button(
            self.layout,
            artifact.operator,
            "Update" if stale(context.scene, artifact) else "Build",
            following=steps.next_operator(context.scene),
        )
        self.draw_help()

    def body(self, context, layout, settings) -> None:
        artifact = build_artifact(context.scene)
        changed = [str(change) for change in stale(context.scene, artifact)]
        row = layout.row(align=True)
        for name, icon in (("Build", "GEOMETRY_NODES"), ("Bake", "FREEZE")):
            operator = f"crowd_lod.{name.lower()}"
            text = f"Update {name}" if changed and operator == artifact.operator else name
            button(row, operator, text, icon, steps.next_operator(context.scene))
        row.operator("crowd_lod.remove_build", text="", icon="TRASH")
        label(
            layout,
            f"Changed: {', '.join(changed)}" if changed else _built(settings.build),
            "FILE_REFRESH" if changed else "INFO",
        )
        if settings.build is not None and (size := settings.build.get(IMAGE_BYTES)):
            row = layout.row(align=True)
            label(row, f"Images: {byte_size(size)} in full", "IMAGE_DATA")
            if can_use_cache(context.scene):
                row.operator("crowd_lod.use_texture_cache")


class CROWDLOD_PT_build_advanced(StepPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CROWDLOD_PT_build"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "render_source_characters")


def _built(build: bpy.types.Collection | None) -> str:
    """Return what the build is."""
    if build is None:
        return "Not built"
    try:
        return (
            "Baked: frames {2:g} to {3:g}".format(*baked_of(build))
            if is_bake(build)
            else "Follows frame and camera"
        )
    except CrowdError as error:
        return str(error)


class CROWDLOD_PT_cost(StepPanel, bpy.types.Panel):
    bl_label = "Cost"
    bl_parent_id = "CROWDLOD_PT_build"

    def body(self, context, layout, settings) -> None:
        button(layout, "crowd_lod.estimate", icon="MEMORY")
        column = layout.column(align=True)
        table = costs_of(settings)
        if table is None:
            label(column, "Not estimated")
            return
        self.row(column, NAMES[table.engine], "Memory", "Time")
        for case, cost in table.costs.items():
            # what is baked is the case above it
            name = "Baked" if case.is_baked else case.title
            self.row(column, name, byte_size(cost.memory), f"{cost.time:.0%}")
        if table.engine in SEEN:
            ranges = ["{:g} to {:g} x".format(*seen) for seen in SEEN[table.engine]]
            self.row(column, "Measured", *ranges)

    def row(self, layout, name: str, memory: str, time: str) -> None:
        """Draw a row of the table."""
        row = layout.split(factor=0.42)
        label(row, name)
        row = row.split(factor=0.5)
        label(row, memory)
        label(row, time)


class CROWDLOD_PT_view_layers(StepPanel, bpy.types.Panel):
    bl_label = "View Layers"
    bl_parent_id = "CROWDLOD_PT_build"

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene.crowd_lod.build is not None

    def body(self, context, layout, settings) -> None:
        for name, place in layers_of(context.scene).items():
            row = layout.row()
            row.use_property_split = False
            row.alignment = "LEFT"
            # its icon, a checkbox, is a full one where the layer is not excluded
            row.prop(place, "exclude", text=name, emboss=False, translate=False)
        layout.operator("crowd_lod.add_aovs", icon="RENDERLAYERS")


class CROWDLOD_PT_verify(StepPanel, bpy.types.Panel):
    bl_label = "Verify"
    main = ("crowd_lod.verify", "Verify")

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "verify_count")
        row = _with_report(
            layout, "crowd_lod.verify", "CHECKMARK", "VERIFY", steps.next_operator(context.scene)
        )
        row.operator("crowd_lod.show_proof", text="", icon="IMAGE_DATA")
        _with_report(layout, "crowd_lod.report_error", "GRAPH", "ERROR", "")


class CROWDLOD_PT_hand_over(StepPanel, bpy.types.Panel):
    bl_label = "Hand Over"

    def body(self, context, layout, settings) -> None:
        scene = context.scene
        lacks = [] if needs.crowd(scene) or needs.camera(scene) else _lacks(scene)
        for lack in lacks:
            _draw_lack(layout, lack, letters_of(context))
        sizes = sizes_of(scene)
        self.bake(context, layout.column(align=True), sizes.get("crowd_lod.bake"))
        layout.separator()
        column = layout.column(align=True)
        column.prop(settings, "usd_file")
        column.prop(settings, "animated_prototypes")
        button(column, "crowd_lod.export_usd", icon="EXPORT")
        if missing_openusd(scene):
            label(column, "This Blender has no OpenUSD", "INFO")
        elif size := sizes.get("crowd_lod.export_usd"):
            label(column, f"Written: {size}", "FILE")
        layout.separator()
        column = layout.column(align=True)
        wide(column, settings, "frames_per_task")
        button(column, "crowd_lod.write_farm_job", icon="NETWORK_DRIVE")
        frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        tasks = counted(-(-len(frames) // settings.frames_per_task), "task")
        label(column, tasks, "INFO")
        if size := sizes.get("crowd_lod.write_farm_job"):
            label(column, f"Written: {size}", "FILE")

    def bake(self, context, layout, size: str | None) -> None:
        """Draw the button of the bake, gray where it would make the same again.

        size: of the open file, in words, if it is saved as it is.
        """
        scene = context.scene
        settings = scene.crowd_lod
        is_baked = is_bake(settings.build)
        row = layout.row()
        row.enabled = not is_baked or bool(stale(scene, BAKE))
        button(row, "crowd_lod.bake", "Update Bake" if is_baked else "Bake", "FREEZE")
        if is_baked:
            label(layout, _built(settings.build), "CHECKMARK" if not row.enabled else "INFO")
            if size:
                label(layout, f"Saved: {size}", "FILE")
        elif settings.build is not None:
            label(layout, "The live build needs Crowd LOD", "INFO")


def _lacks(scene: bpy.types.Scene) -> list[Lack]:
    """Return what the outputs still need; what several of them need counts once."""
    outputs = "crowd_lod.bake", "crowd_lod.export_usd", "crowd_lod.write_farm_job"
    return list(dict.fromkeys(lack for name in outputs for lack in lacks_of(scene, name)))


def _draw_lack(layout, lack: Lack, letters: int) -> None:
    """Draw what is missing or out of date, and beside it the step to press."""
    row = layout.row(align=True)
    paragraph(row, lack.sentence, "ERROR", letters - 3)
    row.operator(lack.operator, text="", icon="FORWARD")


CLASSES = (
    CROWDLOD_PT_plan,
    CROWDLOD_PT_budget,
    CROWDLOD_PT_overrides,
    CROWDLOD_PT_plan_output,
    CROWDLOD_PT_preview,
    CROWDLOD_PT_build,
    CROWDLOD_PT_cost,
    CROWDLOD_PT_view_layers,
    CROWDLOD_PT_build_advanced,
    CROWDLOD_PT_verify,
    CROWDLOD_PT_hand_over,
)
