"""The panels of the sidebar, a step of the work each. They only draw.

Their height does not change while one works: figures, messages and the account of an agent are in
popovers and in the viewport; what does not apply is grayed.
"""

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.labelled_properties import CONTEXT
from ..build import staleness
from ..build.render_setup import BAKED, baked_of
from ..build.view_layers import layers_of
from ..lod_meshes.made_for import outdated
from ..overlay import viewport_overlay
from . import steps
from .drawing import LOD_COLORS, MOST_ROWS, button, cells, greyed, label, length, table, wide


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Crowd LOD"
    bl_translation_context = CONTEXT


class CROWDLOD_PT_main(_Sidebar, bpy.types.Panel):
    bl_label = "Crowd LOD"

    def draw_header_preset(self, context) -> None:
        _presets(self.layout, "all")

    def draw(self, context) -> None:
        column, scene = self.layout.column(align=True), context.scene
        row = column.row(align=True)
        row.prop(scene.crowd_lod, "overlay", text="", icon="OVERLAY")
        row.popover("CROWDLOD_PT_statistics", text=_line(scene), translate=False)
        sentence, icon = steps.messages(scene)[0]
        row = column.row(align=True)
        row.alert = icon == "ERROR"
        row.popover("CROWDLOD_PT_messages", text=sentence, icon=icon, translate=False)


def _line(scene: bpy.types.Scene) -> str:
    """Return the frame's figures in one line."""
    frame = viewport_overlay.latest(scene)
    if frame is None:
        return "Statistics: overlay off" if not scene.crowd_lod.overlay else "Statistics"
    seen = f"{len(frame.buckets.order):,} of {len(frame.crowd):,} visible"
    return f"{seen}, {frame.triangles / frame.full_triangles:.0%} triangles" if frame.full_triangles else seen


class _Step(_Sidebar):
    """The panel of one step of the work; `body(context, layout, settings)` draws it.

    step: of ui.presets.STEPS; "" for a panel without presets.
    main: (operator, text) of the button in the header; () for none.
    """

    bl_parent_id = "CROWDLOD_PT_main"
    bl_options = {"DEFAULT_CLOSED"}
    step = ""
    main: tuple[str, ...] = ()

    def draw_header_preset(self, context) -> None:
        if self.main:
            button(self.layout, *self.main, following=steps.following(context.scene))

    def draw(self, context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        if self.step:
            row = layout.row()
            row.alignment = "RIGHT"
            _presets(row, self.step)
        self.body(context, layout, context.scene.crowd_lod)


def _presets(layout, step: str) -> None:
    row = layout.row()
    row.emboss = "NONE"
    row.popover(f"CROWDLOD_PT_{step}_presets", text="", icon="PRESET")


class CROWDLOD_PT_crowd(_Step, bpy.types.Panel):
    bl_label = "Crowd"
    bl_options = set()
    step = "crowd"

    def draw_header_preset(self, context) -> None:
        following = steps.following(context.scene)
        if context.scene.crowd_lod.characters is None:
            button(self.layout, "crowd_lod.characters_from_selection", "From Selection", following=following)
        else:
            button(self.layout, "crowd_lod.populate", "Populate", following=following)

    def body(self, context, layout, settings) -> None:
        following = steps.following(context.scene)
        layout.prop(settings, "characters")
        button(layout, "crowd_lod.characters_from_selection", icon="RESTRICT_SELECT_OFF", following=following)
        for name in ("forward", "count", "seed", "center", "size"):
            layout.prop(settings, name)
        button(layout, "crowd_lod.populate", icon="OUTLINER_OB_POINTCLOUD", following=following)


class CROWDLOD_PT_groups(_Step, bpy.types.Panel):
    bl_label = "Character Groups"
    bl_parent_id = "CROWDLOD_PT_crowd"

    def body(self, context, layout, settings) -> None:
        rows = [(g.name, length(context, g.radius), length(context, g.stride)) for g in settings.groups]
        table(layout, ("Group", "Radius", "Stride"), rows or [("Press Populate", "", "")])
        for group in [group for group in settings.groups if group.lowest][:MOST_ROWS]:
            layout.prop(group, "on_ground", text=f"{group.name} on Ground", translate=False)


class CROWDLOD_PT_samples(_Step, bpy.types.Panel):
    bl_label = "Sample Scenes"
    bl_parent_id = "CROWDLOD_PT_crowd"

    def body(self, context, layout, settings) -> None:
        row = layout.row()
        for name in ("chapter", "plaza"):
            row.operator("crowd_lod.sample", text=name.capitalize(), translate=False).name = name


class CROWDLOD_PT_behaviour(_Step, bpy.types.Panel):
    bl_label = "Behavior"
    step = "behavior"

    def body(self, context, layout, settings) -> None:
        label(layout, "Label Map")
        layout.template_ID(settings, "map_image", open="image.open")
        label(layout, "State Machine")
        layout.template_ID(settings, "machine", new="text.new", open="text.open")
        layout.menu("CROWDLOD_MT_machine_presets", icon="PRESET")
        layout.prop(settings, "first_frame")
        frame = viewport_overlay.latest(context.scene)
        machine = frame and frame.trajectory.machine
        told = f"{len(machine.states)} states, {len(machine.labels)} labels; edge: {machine.edge}" if machine else "-"
        label(layout, told, "INFO")


class CROWDLOD_PT_heights(_Step, bpy.types.Panel):
    bl_label = "Height Map"
    bl_parent_id = "CROWDLOD_PT_behaviour"

    def body(self, context, layout, settings) -> None:
        layout.template_ID(settings, "height_image", open="image.open")
        column = greyed(layout, settings.height_image is not None)
        column.prop(settings, "height_scale")
        column.prop(settings, "tilt")


class CROWDLOD_PT_camera(_Step, bpy.types.Panel):
    bl_label = "Camera"
    step = "camera"

    def body(self, context, layout, settings) -> None:
        layout.prop(context.scene, "camera", text="Active Camera", translate=False)
        wide(layout, settings, "shadows")
        greyed(layout, settings.shadows).prop(settings, "mirrors")


class CROWDLOD_PT_culling(_Step, bpy.types.Panel):
    bl_label = "Culling"
    bl_parent_id = "CROWDLOD_PT_camera"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "margin_kind")
        greyed(layout, settings.margin_kind == "FIXED").prop(settings, "margin", text="Distance", translate=False)
        wide(greyed(layout, context.scene.render.use_border), settings, "cull_to_border")
        wide(layout, settings, "drop_lost")
        greyed(layout, settings.shadows).prop(settings, "unseen_level")


class CROWDLOD_PT_levels(_Step, bpy.types.Panel):
    bl_label = "Levels of Detail"
    step, main = "levels", ("crowd_lod.make_levels", "Make")

    def body(self, context, layout, settings) -> None:
        row = layout.row()
        row.use_property_split = False
        row.prop(settings, "choice", expand=True)
        if settings.choice == "BY_TOLERANCE":
            layout.prop(settings, "tolerance")
            layout.prop(settings, "memory", text="Memory", translate=False)
        else:
            layout.prop(settings, "level_count")
            layout.prop(settings, "metric")
            self.ratios(context, layout, settings)
        button(layout, "crowd_lod.make_levels", icon="MOD_DECIM", following=steps.following(context.scene))
        told = outdated(context.scene)
        made = "Press Make LOD Meshes" if settings.levels is None else "LOD meshes are made"
        label(layout, told or made, "FILE_REFRESH" if told else "INFO")

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
            elif settings.metric == "PIXELS":
                row.prop(settings, "sizes", index=level - 1, text="")
                label(row, "pixels")
            else:
                row.prop(settings, "thresholds", index=level - 1, text="")
                label(row, length(context, far * settings.thresholds[level - 1]) if far else "?")


class CROWDLOD_PT_own_thresholds(_Step, bpy.types.Panel):
    bl_label = "Thresholds of Groups"
    bl_parent_id = "CROWDLOD_PT_levels"

    @classmethod
    def poll(cls, context) -> bool:
        settings = context.scene.crowd_lod
        return settings.choice == "BY_RATIO" and settings.level_count > 1 and len(settings.groups) > 0

    def body(self, context, layout, settings) -> None:
        layout.use_property_split = False
        for group in settings.groups[:MOST_ROWS]:
            layout.prop(group, "own_thresholds", text=group.name, translate=False)
            row = layout.row(align=True)
            row.active = group.own_thresholds
            for level in range(settings.level_count - 1):
                row.prop(group, "sizes" if settings.metric == "PIXELS" else "thresholds", index=level, text="")


class CROWDLOD_PT_decimation(_Step, bpy.types.Panel):
    bl_label = "Decimation and Textures"
    bl_parent_id = "CROWDLOD_PT_levels"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "method")
        greyed(layout, settings.choice == "BY_TOLERANCE").prop(settings, "shading_counts")
        layout.prop(settings, "scale_textures")
        layout.prop(settings, "bias_image")
        button(layout, "crowd_lod.measure_levels", icon="DRIVER_DISTANCE")


class CROWDLOD_PT_overlay(_Step, bpy.types.Panel):
    bl_label = "Overlay"
    step = "overlay"

    def draw_header(self, context) -> None:
        self.layout.prop(context.scene.crowd_lod, "overlay", text="")

    def body(self, context, layout, settings) -> None:
        column = greyed(layout, settings.overlay)
        for name in ("overlay_camera", "overlay_mode", "overlay_color", "hud", "inset"):
            column.prop(settings, name)
        row = column.row(align=True)
        row.prop(settings, "agent")
        row.operator("crowd_lod.inspect", text="", icon="EYEDROPPER")
        row.popover("CROWDLOD_PT_agent", text="", icon="INFO")
        column.operator("crowd_lod.render_viewport", icon="RENDER_STILL")


class CROWDLOD_PT_drawing(_Step, bpy.types.Panel):
    bl_label = "Drawing"
    bl_parent_id = "CROWDLOD_PT_overlay"

    def body(self, context, layout, settings) -> None:
        column = greyed(layout, settings.overlay)
        for name in ("overlay_culled", "overlay_fade", "hysteresis"):
            column.prop(settings, name)


class CROWDLOD_PT_plan(_Step, bpy.types.Panel):
    bl_label = "Plan Shot"
    step, main = "plan", ("crowd_lod.plan_shot", "Plan")

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "own_frames")
        column = greyed(layout, settings.own_frames and not settings.frames).column(align=True)
        column.prop(settings, "frame_start")
        column.prop(settings, "frame_end")
        layout.prop(settings, "avoid_pops")
        _with_report(layout, "crowd_lod.plan_shot", "TIME", "PLAN", steps.following(context.scene))
        row = layout.row(align=True)
        row.use_property_split = False
        row.enabled = bool(settings.shot_plan)
        row.prop(settings, "use_shot_plan", toggle=True)
        row.operator("crowd_lod.remove_plan", text="", icon="TRASH")
        layout.operator("crowd_lod.go_to_switch", icon="VIEWZOOM")
        label(layout, *_held(context.scene))


def _with_report(layout, name: str, icon: str, which: str, following: str) -> None:
    """Draw the button of a step, and beside it the one that opens its report."""
    row = layout.row(align=True)
    button(row, name, icon=icon, following=following)
    row.operator("crowd_lod.open_report", text="", icon="URL").which = which


def _held(scene: bpy.types.Scene) -> tuple[str, str]:
    """Return (whether the stored plan holds in the frame that the overlay shows, its icon)."""
    if not scene.crowd_lod.shot_plan:
        return "No plan: LODs by distance", "INFO"
    frame = viewport_overlay.latest(scene) if scene.crowd_lod.use_shot_plan else None
    if frame is None:
        return "Switched off" if not scene.crowd_lod.use_shot_plan else "The overlay tells if it holds", "INFO"
    if frame.planned:
        return f"Frame {frame.time:g} is as planned", "CHECKMARK"
    return ("Does not hold: see above", "ERROR") if frame.unplanned else ("The viewport's view has no plan", "INFO")


class CROWDLOD_PT_budget(_Step, bpy.types.Panel):
    bl_label = "Budget"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "budget_triangles")
        layout.prop(settings, "budget_memory")
        wide(layout, settings, "plan_blurred")


class CROWDLOD_PT_exceptions(_Step, bpy.types.Panel):
    bl_label = "Exceptions"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        row = layout.row()
        row.use_property_split = False
        row.template_list("CROWDLOD_UL_exceptions", "", settings, "exceptions", settings, "exception_index", rows=4)
        column = row.column(align=True)
        column.operator("crowd_lod.add_exception", text="", icon="ADD")
        column.operator("crowd_lod.remove_exception", text="", icon="REMOVE")
        for by, icon in ((-1, "TRIA_UP"), (1, "TRIA_DOWN")):
            column.operator("crowd_lod.move_exception", text="", icon=icon).by = by
        layout.operator("crowd_lod.except_agent", icon="EYEDROPPER")
        if settings.exception_index < len(settings.exceptions):
            self.entry(layout, settings.exceptions[settings.exception_index])

    def entry(self, layout, entry) -> None:
        """Draw the settings of the selected exception."""
        column = greyed(layout, entry.use)
        column.prop(entry, "kind")
        greyed(column, entry.kind != "HIDE").prop(entry, "level")
        column.prop(entry, "chosen_by")
        column.prop(entry, {"MAP": "map_image", "NUMBERS": "agents", "REGION": "region"}[entry.chosen_by])
        column.prop(entry, "all_frames")
        frames = greyed(column, not entry.all_frames)
        frames.prop(entry, "first_frame")
        frames.prop(entry, "last_frame")


class CROWDLOD_PT_plan_output(_Step, bpy.types.Panel):
    bl_label = "Output"
    bl_parent_id = "CROWDLOD_PT_plan"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "frames")
        layout.prop(settings, "plan_folder")
        layout.prop(settings, "shot_plan")


class CROWDLOD_PT_preview(_Step, bpy.types.Panel):
    bl_label = "Preview"
    step, main = "preview", ("crowd_lod.preview", "Preview")

    def body(self, context, layout, settings) -> None:
        for name in ("step", "width", "engine"):
            layout.prop(settings, name)
        # else its color is the overlay's
        greyed(layout, settings.engine != "OVERLAY").prop(settings, "color")
        layout.prop(settings, "above", text="From Above", translate=False)
        layout.prop(settings, "folder")
        _with_report(layout, "crowd_lod.preview", "RENDER_ANIMATION", "PREVIEW", "")


class CROWDLOD_PT_build(_Step, bpy.types.Panel):
    bl_label = "Build"

    def draw_header_preset(self, context) -> None:
        text = "Update" if staleness.changed(context.scene) else "Build"
        button(self.layout, _build_of(context.scene), text, following=steps.following(context.scene))

    def body(self, context, layout, settings) -> None:
        changed, own = staleness.changed(context.scene), _build_of(context.scene)
        row = layout.row(align=True)
        for name, icon in (("Build", "GEOMETRY_NODES"), ("Bake", "FREEZE")):
            operator = f"crowd_lod.{name.lower()}"
            text = f"Update {name}" if changed and operator == own else name
            button(row, operator, text, icon, steps.following(context.scene))
        row.operator("crowd_lod.remove_build", text="", icon="TRASH")
        label(
            layout, f"Changed: {', '.join(changed)}" if changed else _built(settings.build), "FILE_REFRESH" if changed else "INFO"
        )
        layout.prop(settings, "keep_characters")


def _build_of(scene: bpy.types.Scene) -> str:
    """Return the operator that made the scene's build, or that makes one."""
    build = scene.crowd_lod.build
    return "crowd_lod.bake" if build is not None and BAKED in build else "crowd_lod.build"


def _built(build: bpy.types.Collection | None) -> str:
    """Return what the build is."""
    if build is None:
        return "Not built"
    try:
        return "Baked: frames {2:g} to {3:g}".format(*baked_of(build)) if BAKED in build else "Follows frame and camera"
    except CrowdError as error:
        return str(error)


class CROWDLOD_PT_cost(_Step, bpy.types.Panel):
    bl_label = "Cost"
    bl_parent_id = "CROWDLOD_PT_build"

    def body(self, context, layout, settings) -> None:
        button(layout, "crowd_lod.estimate", icon="MEMORY")
        head, *rows = (line.split("\t") for line in settings.estimate.splitlines()) if settings.estimate else (("Not estimated",),)
        table(layout, head, rows)


class CROWDLOD_PT_view_layers(_Step, bpy.types.Panel):
    bl_label = "View Layers"
    bl_parent_id = "CROWDLOD_PT_build"

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene.crowd_lod.build is not None and len(context.scene.view_layers) > 1

    def body(self, context, layout, settings) -> None:
        for name, place in layers_of(context.scene).items():
            layout.prop(place, "exclude", text=name, invert_checkbox=True, translate=False)


class CROWDLOD_PT_verify(_Step, bpy.types.Panel):
    bl_label = "Verify"
    step, main = "verify", ("crowd_lod.verify", "Verify")

    def body(self, context, layout, settings) -> None:
        for name in ("verify_count", "verify_width", "verify_samples", "verify_folder"):
            layout.prop(settings, name)
        _with_report(layout, "crowd_lod.verify", "CHECKMARK", "VERIFY", steps.following(context.scene))


CLASSES = (
    CROWDLOD_PT_main,
    CROWDLOD_PT_crowd,
    CROWDLOD_PT_groups,
    CROWDLOD_PT_samples,
    CROWDLOD_PT_behaviour,
    CROWDLOD_PT_heights,
    CROWDLOD_PT_camera,
    CROWDLOD_PT_culling,
    CROWDLOD_PT_levels,
    CROWDLOD_PT_own_thresholds,
    CROWDLOD_PT_decimation,
    CROWDLOD_PT_overlay,
    CROWDLOD_PT_drawing,
    CROWDLOD_PT_plan,
    CROWDLOD_PT_budget,
    CROWDLOD_PT_exceptions,
    CROWDLOD_PT_plan_output,
    CROWDLOD_PT_preview,
    CROWDLOD_PT_build,
    CROWDLOD_PT_cost,
    CROWDLOD_PT_view_layers,
    CROWDLOD_PT_verify,
)
