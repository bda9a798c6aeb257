"""The panels of the sidebar, in the order of the work. They only draw."""

import textwrap

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import number
from ...crowd_lod.levels.assignment import MOST_LEVELS
from ...crowd_lod.planning.reasons import REASONS
from ...crowd_lod.simplification.decimate import missing_library
from ..blender import scene_data
from ..build.render_setup import BAKED, baked_of
from ..build.view_layers import layers_of
from ..crowd.scene_crowd import count_of
from ..overlay import viewport_overlay
from ..overlay.hud import STAGES, share, told

# Name and icon of each LOD's color in lod_meshes.candidates.TINTS.
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
MOST_ROWS = 12  # of a table of groups


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Crowd LOD"


class _Step(_Sidebar):
    """The panel of one step of the work; `body(context, layout, settings)` draws it."""

    bl_parent_id = "CROWDLOD_PT_main"

    def draw(self, context) -> None:
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.body(context, self.layout, context.scene.crowd_lod)


class CROWDLOD_PT_main(_Sidebar, bpy.types.Panel):
    bl_label = "Crowd LOD"

    def draw(self, context) -> None:
        layout = self.layout
        problem = viewport_overlay.problem(context.scene)
        shown = viewport_overlay.shown_of(context.scene)
        if problem:
            _say(context, layout, problem, "ERROR")
        elif shown:
            _figures(layout, shown.frame)
            for note in shown.notes:
                _say(context, layout, note, "INFO")
        elif len(context.scene.crowd_lod.groups):
            layout.prop(context.scene.crowd_lod, "overlay", text="Overlay and Statistics", toggle=True, icon="OVERLAY")
        else:
            _say(context, layout, "Choose the characters and press Populate, or make a sample scene.", "INFO")


def _figures(layout, frame) -> None:
    agents, visible = len(frame.crowd), len(frame.buckets.order)
    rows = [
        ("Frame", f"{frame.time:g}", "BLANK1"),
        ("Agents", f"{agents:,}", "BLANK1"),
        ("Visible", f"{visible:,}", "HIDE_OFF"),
        ("Culled", f"{agents - visible:,}  ({(agents - visible) / max(agents, 1):.1%})", "HIDE_ON"),
    ]
    for level, count in enumerate(frame.buckets.counts):
        name, icon = LOD_COLORS[level]
        rows.append((f"LOD {level}, {name}", f"{count:,}", icon))
    if frame.full_triangles:
        rows += [("Vertices", share(frame.vertices, frame.full_vertices), "VERTEXSEL")]
        rows += [("Triangles", share(frame.triangles, frame.full_triangles), "MESH_DATA")]
    icon = "TIME"
    for stage, milliseconds in frame.milliseconds.items():
        rows.append((STAGES[stage], f"{milliseconds:.2f} ms", icon))
        icon = "BLANK1"
    column = layout.column(align=True)
    for name, value, icon in rows:
        split = column.split(factor=0.48)
        split.label(text=name, icon=icon)
        split.label(text=value)


class CROWDLOD_PT_crowd(_Step, bpy.types.Panel):
    bl_label = "Crowd"

    def body(self, context, layout, settings) -> None:
        layout.label(text="Sample scenes")
        row = layout.row()
        for name in ("chapter", "plaza"):
            row.operator("crowd_lod.sample", text=name.capitalize()).name = name
        layout.prop(settings, "characters")
        layout.prop(settings, "keep_characters")
        layout.prop(settings, "forward")
        layout.prop(settings, "count")
        layout.prop(settings, "seed")
        layout.prop(settings, "center", text="Center")
        layout.prop(settings, "size")
        layout.operator("crowd_lod.populate", icon="OUTLINER_OB_POINTCLOUD")
        if len(settings.groups):
            rows = [(g.name, _length(context, g.radius), _length(context, g.stride)) for g in settings.groups]
            _table(layout, ("Group", "Radius", "Stride"), rows)
        for group in [group for group in settings.groups if group.lowest][:MOST_ROWS]:
            layout.prop(group, "on_ground", text=f"{group.name} Stands on Ground")


class CROWDLOD_PT_behaviour(_Step, bpy.types.Panel):
    bl_label = "Behavior"

    def body(self, context, layout, settings) -> None:
        layout.label(text="Label map")
        layout.template_ID(settings, "map_image", open="image.open")
        layout.label(text="Height map")
        layout.template_ID(settings, "height_image", open="image.open")
        if settings.height_image is not None:
            layout.prop(settings, "height_scale")
            layout.prop(settings, "tilt")
        layout.label(text="State machine")
        layout.template_ID(settings, "machine", new="text.new", open="text.open")
        layout.menu("CROWDLOD_MT_machine_presets", icon="PRESET")
        layout.prop(settings, "first_frame")
        if settings.trouble:
            _say(context, layout, settings.trouble, "ERROR")
        shown = viewport_overlay.shown_of(context.scene)
        if shown and shown.frame:
            machine = shown.frame.trajectory.machine
            layout.label(text=f"{machine.name}: {len(machine.states)} states, {len(machine.labels)} labels")
            layout.label(text=f"At the map's edge: {machine.edge}")


class CROWDLOD_PT_camera(_Step, bpy.types.Panel):
    bl_label = "Camera"

    def body(self, context, layout, settings) -> None:
        layout.prop(context.scene, "camera", text="Active Camera")
        camera = context.scene.camera
        if camera is None or camera.type != "CAMERA":
            _say(context, layout, "The scene needs an active camera.", "ERROR")
        else:
            column = layout.column(align=True)
            column.prop(camera.data, "clip_start")
            column.prop(camera.data, "clip_end", text="End")
        layout.prop(settings, "margin_kind")
        if settings.margin_kind == "FIXED":
            layout.prop(settings, "margin", text=" ")
        if context.scene.render.use_border:
            layout.prop(settings, "cull_to_border")
        layout.prop(settings, "drop_lost")
        layout.prop(settings, "shadows")
        if settings.shadows:
            layout.prop(settings, "mirrors")
            layout.prop(settings, "unseen_level")


class CROWDLOD_PT_levels(_Step, bpy.types.Panel):
    bl_label = "Levels of Detail"

    def body(self, context, layout, settings) -> None:
        problem = missing_library()
        if problem:
            _say(context, layout, problem, "ERROR")
        layout.row().prop(settings, "choice", expand=True)
        tolerant = settings.choice == "BY_TOLERANCE"
        for name in ("tolerance", "shading_counts", "memory") if tolerant else ("level_count", "metric"):
            layout.prop(settings, name)
        layout.prop(settings, "bias_image")
        layout.use_property_split = False
        if not tolerant:
            self.ratios(context, layout, settings)
        layout.prop(settings, "method")
        layout.prop(settings, "scale_textures")
        layout.operator("crowd_lod.make_levels", icon="MOD_DECIM")
        if settings.levels is None:
            if tolerant:
                _say(context, layout, "Until its LODs are made and measured, the crowd is all LOD 0.", "INFO")
            return
        layout.operator("crowd_lod.measure_levels", icon="DRIVER_DISTANCE")
        frame, names = viewport_overlay.latest(context.scene), [group.name for group in settings.groups]
        # an undo may have brought other groups since the frame was drawn
        current = frame is not None and [group.name for group in frame.trajectory.groups] == names
        begins = frame.begins if current else None
        count = min(max(count_of(settings), 1), MOST_LEVELS)  # the user may have put collections in, or taken them out
        for g, group in enumerate(settings.groups[: MOST_ROWS // count]):
            rows = []
            for k in (k for k in range(count) if group.triangles[k]):
                begin = begins[g, k - 1] if begins is not None and k and begins.shape[1] >= k else None
                deviates = f"{number(1000 * scene_data.metres(context.scene) * group.deviations[k])} mm" if group.diagonal else "-"
                rows.append((f"LOD {k}", f"{group.triangles[k]:,}", deviates, _distance(context, begin)))
            _table(layout, (group.name, "Triangles", "Deviates", "From"), rows)
        if tolerant and settings.dropped:
            lines = settings.dropped.splitlines()
            layout.label(text=f"Not made: {len(lines)} candidates")
            for line in lines[:MOST_ROWS]:
                _say(context, layout, line, "DOT")

    def ratios(self, context, layout, settings) -> None:
        """Draw, for each LOD, the settings of what it keeps and where it begins."""
        camera = context.scene.camera
        far = camera.data.clip_end if camera is not None and camera.type == "CAMERA" else None
        grid = layout.column(align=True)
        _cells(grid, ("LOD", "Ratio", "From", "Distance"))
        for level in range(settings.level_count):
            cells = _cells(grid, (str(level),), icon=LOD_COLORS[level][1], columns=4)
            cells.prop(settings, "ratios", index=level, text="")
            if level == 0:
                cells.label(text="near")
                cells.label(text="")
            elif settings.metric == "PIXELS":
                cells.prop(settings, "sizes", index=level - 1, text="")
                cells.label(text="pixels")
            else:
                cells.prop(settings, "thresholds", index=level - 1, text="")
                threshold = settings.thresholds[level - 1]
                cells.label(text=_length(context, far * threshold) if far else "?")
        for group in settings.groups[:MOST_ROWS] if settings.level_count > 1 else ():
            layout.prop(group, "own_thresholds", text=f"{group.name}: thresholds of its own")
            if group.own_thresholds:
                row = layout.row(align=True)
                for level in range(settings.level_count - 1):
                    row.prop(group, "sizes" if settings.metric == "PIXELS" else "thresholds", index=level, text="")


class CROWDLOD_PT_plan(_Step, bpy.types.Panel):
    bl_label = "Plan Shot"

    def body(self, context, layout, settings) -> None:
        for name in ("frames", "avoid_pops", "budget_triangles", "budget_memory", "plan_blurred", "plan_folder"):
            layout.prop(settings, name)
        layout.operator("crowd_lod.plan_shot", icon="TIME")
        if settings.shot_plan:
            row = layout.row(align=True)
            row.use_property_split = False
            row.prop(settings, "use_shot_plan", toggle=True)
            row.operator("crowd_lod.remove_plan", text="", icon="TRASH")
            layout.operator("crowd_lod.go_to_switch", icon="VIEWZOOM")
            if settings.use_shot_plan:
                _say(context, layout, *_held(context.scene))
        self.exceptions(layout, settings)

    def exceptions(self, layout, settings) -> None:
        """Draw the list of exceptions, and the settings of the selected one."""
        layout.label(text="Exceptions")
        row = layout.row()
        row.use_property_split = False
        row.template_list("CROWDLOD_UL_exceptions", "", settings, "exceptions", settings, "exception_index", rows=3)
        column = row.column(align=True)
        column.operator("crowd_lod.add_exception", text="", icon="ADD")
        column.operator("crowd_lod.remove_exception", text="", icon="REMOVE")
        for by, icon in ((-1, "TRIA_UP"), (1, "TRIA_DOWN")):
            column.operator("crowd_lod.move_exception", text="", icon=icon).by = by
        if settings.exception_index < len(settings.exceptions):
            entry = settings.exceptions[settings.exception_index]
            column = layout.column()
            column.active = entry.use
            column.prop(entry, "kind")
            if entry.kind != "HIDE":
                column.prop(entry, "level")
            column.prop(entry, "chosen_by")
            if entry.chosen_by == "MAP":
                column.template_ID(entry, "map_image", open="image.open")
            else:
                column.prop(entry, "agents" if entry.chosen_by == "NUMBERS" else "region")
            column.prop(entry, "all_frames")
            if not entry.all_frames:
                column.prop(entry, "first_frame")
                column.prop(entry, "last_frame")
        layout.operator("crowd_lod.except_agent", icon="EYEDROPPER")


def _held(scene: bpy.types.Scene) -> tuple[str, str]:
    """Return (a sentence on whether the stored plan holds in the frame that the overlay shows, its icon)."""
    frame = viewport_overlay.latest(scene)
    if frame is None:
        return "Switch the overlay on to see whether the plan still holds.", "INFO"
    if frame.planned:
        return f"Frame {frame.time:g} is as planned.", "CHECKMARK"
    if frame.unplanned:
        return frame.unplanned, "ERROR"
    return "The overlay shows the viewport's own view, which is not planned.", "INFO"


class CROWDLOD_PT_preview(_Step, bpy.types.Panel):
    bl_label = "Preview"

    def body(self, context, layout, settings) -> None:
        layout.prop(settings, "overlay")
        column = layout.column()
        column.active = settings.overlay
        for name in ("overlay_camera", "overlay_mode", "overlay_color", "overlay_culled", "overlay_fade", "hysteresis"):
            column.prop(settings, name)
        column.prop(settings, "hud")
        column.prop(settings, "inset")
        row = column.row(align=True)
        row.prop(settings, "agent")
        row.operator("crowd_lod.inspect", text="", icon="EYEDROPPER")
        account = viewport_overlay.account_of(context.scene)
        if account is not None:
            _table(column, ("Agent", f"{account.agent:,}"), told(account)[1:])
        if settings.overlay_color == "REASON":
            for reason, (_, icon) in zip(REASONS, LOD_COLORS, strict=False):
                column.label(text=reason.capitalize(), icon=icon)
        elif settings.overlay_color == "GROUP":
            for group, (_, icon) in zip(settings.groups, LOD_COLORS, strict=False):
                column.label(text=group.name, icon=icon)
        column.operator("crowd_lod.render_viewport", icon="RENDER_STILL")
        for name in ("frames", "step", "width", "engine"):
            layout.prop(settings, name)
        if settings.engine != "OVERLAY":  # its color is the overlay's, above
            layout.prop(settings, "color")
        layout.prop(settings, "above", text="From Above")
        layout.prop(settings, "folder")
        layout.operator("crowd_lod.preview", icon="RENDER_ANIMATION")


class CROWDLOD_PT_build(_Step, bpy.types.Panel):
    bl_label = "Build"

    def body(self, context, layout, settings) -> None:
        layout.operator("crowd_lod.estimate", icon="MEMORY")
        if settings.estimate:
            head, *rows = (line.split("\t") for line in settings.estimate.splitlines())
            _table(layout, tuple(head), [tuple(row) for row in rows])
        row = layout.row(align=True)
        row.operator("crowd_lod.build", icon="GEOMETRY_NODES")
        row.operator("crowd_lod.bake", icon="FREEZE")
        if settings.build is not None and BAKED in settings.build:
            try:
                layout.label(text="Baked: frames {2:g} to {3:g}".format(*baked_of(settings.build)), icon="FREEZE")
            except CrowdError as error:
                _say(context, layout, str(error), "ERROR")
        if settings.build is not None and len(context.scene.view_layers) > 1:
            column = layout.column(heading="View Layers")
            for name, place in layers_of(context.scene).items():
                column.prop(place, "exclude", text=name, invert_checkbox=True)
        layout.operator("crowd_lod.remove_build", icon="TRASH")


def _length(context, units: float) -> str:
    return bpy.utils.units.to_string(
        context.scene.unit_settings.system, "LENGTH", units * scene_data.metres(context.scene), precision=3
    )


def _distance(context, units: float | None) -> str:
    """Return a distance of `limits`, where a LOD begins, as text; "-" for None."""
    if units is None:
        return "-"
    return _length(context, units) if abs(units) < float("inf") else "never" if units > 0 else "always"


def _table(layout, head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    box = layout.box().column(align=True)
    _cells(box, head)
    for row in rows[:MOST_ROWS]:
        _cells(box, row)
    if len(rows) > MOST_ROWS:
        box.label(text=f"and {len(rows) - MOST_ROWS} more")


def _cells(layout, texts: tuple[str, ...], icon: str = "NONE", columns: int = 0) -> bpy.types.UILayout:
    """Draw a row of equal columns, the first of them with these texts, and return it."""
    cells = layout.grid_flow(row_major=True, columns=columns or len(texts), even_columns=True, align=True)
    for index, text in enumerate(texts):
        cells.label(text=text, icon=icon if index == 0 else "NONE")
    return cells


def _say(context, layout, sentence: str, icon: str) -> None:
    """Draw a sentence, broken into lines that fit the sidebar."""
    letters = int(context.region.width / context.preferences.system.ui_scale / 7.2) - 5
    column = layout.column(align=True)
    column.alert = icon == "ERROR"
    for index, line in enumerate(textwrap.wrap(sentence, max(20, letters))):
        column.label(text=line, icon=icon if index == 0 else "BLANK1")


CLASSES = (
    CROWDLOD_PT_main,
    CROWDLOD_PT_crowd,
    CROWDLOD_PT_behaviour,
    CROWDLOD_PT_camera,
    CROWDLOD_PT_levels,
    CROWDLOD_PT_plan,
    CROWDLOD_PT_preview,
    CROWDLOD_PT_build,
)
