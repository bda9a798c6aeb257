"""Popovers: statistics, messages, LOD meshes."""

import bpy

from ...crowd_lod.format import counted, number
from ...crowd_lod.levels.assignment import MOST_LEVELS
from ...crowd_lod.messages import from_json
from ...crowd_lod.shot.budget import fitting_point
from ..blender import scene_data
from ..blender.labeled_properties import CONTEXT
from ..lods.level_objects import GIVEN
from ..scene.characters.stored_groups import count_of
from ..settings.messages import in_words
from ..settings.stored_figures import budget_of, possible_budgets
from ..viewport import viewport_overlay
from ..viewport.hud import STAGES, share
from . import steps
from .drawing import LOD_COLORS, MOST_ROWS, button, distance, label, paragraph, table

LETTERS = 62  # in a line of a popover
REMEDY_ICONS = {
    "crowd_lod.take_action": "ACTION",
    "crowd_lod.take_along": "OUTLINER_COLLECTION",
    "crowd_lod.walls_from_selection": "MOD_BUILD",
}


class _Popover:
    bl_space_type = "VIEW_3D"
    bl_region_type = "HEADER"  # else it would be a panel of the sidebar, too
    bl_options = {"INSTANCED"}
    bl_translation_context = CONTEXT
    bl_ui_units_x = 22  # LETTERS of Blender's font fit


class CROWDLOD_PT_statistics(_Popover, bpy.types.Panel):
    """Figures of the frame that the overlay shows"""

    bl_label = "Statistics"

    def draw(self, context) -> None:
        frame = viewport_overlay.latest(context.scene)
        if frame is None:
            label(self.layout, "Switch the overlay on to see them", "INFO")
            return
        agents = frame.people
        people = frame.without_worn(frame.buckets)
        visible = len(people.order)
        rows = [
            ("Frame", f"{frame.time:g}", "BLANK1"),
            ("Agents", f"{agents:,}", "BLANK1"),
            ("Visible", f"{visible:,}", "HIDE_OFF"),
            (
                "Culled",
                f"{agents - visible:,}  ({(agents - visible) / max(agents, 1):.1%})",
                "HIDE_ON",
            ),
        ]
        if frame.hidden is not None:
            rows.append(
                (
                    "Occluded",
                    f"{frame.hidden[: len(frame.trajectory.bare.start)].sum():,}",
                    "HOME",
                )
            )
        by_lod = context.scene.crowd_lod.overlay_color == "LOD"
        for level, count in enumerate(people.counts):
            name, icon = LOD_COLORS[level]
            rows.append(
                (
                    f"LOD {level}, {name}" if by_lod else f"LOD {level}",
                    f"{count:,}",
                    icon if by_lod else "BLANK1",
                )
            )
        if frame.full_triangles:
            rows += [("Vertices", share(frame.vertices, frame.full_vertices), "VERTEXSEL")]
            rows += [("Triangles", share(frame.triangles, frame.full_triangles), "MESH_DATA")]
        rows += [
            (STAGES[stage], f"{milliseconds:.2f} ms", "TIME")
            for stage, milliseconds in frame.milliseconds.items()
        ]
        column = self.layout.column(align=True)
        for name, value, icon in rows:
            split = column.split(factor=0.5)
            label(split, name, icon)
            label(split, value)
        self.levels(context, context.scene.crowd_lod, frame)
        if frame.left_out:
            label(self.layout, "What this scene does not need")
            for item in frame.left_out:
                paragraph(
                    self.layout, f"{STAGES.get(item.stage, 'Plan')}: {item.reason}", "DOT", LETTERS
                )

    def levels(self, context, settings, frame) -> None:
        """Draw what is known of each group's LODs, and where each begins."""
        if settings.levels is None:
            return
        # an undo may have brought other groups since the frame was drawn
        current = [group.name for group in frame.trajectory.groups] == [
            group.name for group in settings.groups
        ]
        # the user may have put collections in, or taken them out
        count = min(max(count_of(settings), 1), MOST_LEVELS)
        for g, group in enumerate(settings.groups[: max(1, 2 * MOST_ROWS // count)]):
            rows = []
            for k in (k for k in range(count) if group.triangles[k]):
                threshold = (
                    frame.thresholds[g, k - 1]
                    if current and k and frame.thresholds.shape[1] >= k
                    else None
                )
                deviates = (
                    f"{number(1000 * scene_data.meters(context.scene) * group.deviations[k])} mm"
                    if group.diagonal
                    else "-"
                )
                name = f"LOD {k}, given" if _is_given(settings.levels, k, g) else f"LOD {k}"
                rows.append(
                    (name, f"{group.triangles[k]:,}", deviates, distance(context, threshold))
                )
            table(self.layout, (group.name, "Triangles", "Deviates", "From"), rows)
        dropped = from_json(settings.dropped)
        if settings.choice == "BY_TOLERANCE" and dropped:
            label(self.layout, f"Not made: {counted(len(dropped), 'candidate')}")
            for line in in_words(dropped)[:MOST_ROWS]:
                paragraph(self.layout, line.sentence, "DOT", LETTERS)


def _is_given(levels: bpy.types.Collection, k: int, g: int) -> bool:
    """Return whether an artist made LOD `k` of the g-th group."""
    homes = levels.children[k].children if k < len(levels.children) else ()
    return g < len(homes) and any(GIVEN in item for item in homes[g].objects)


class CROWDLOD_PT_messages(_Popover, bpy.types.Panel):
    """All messages about the crowd"""

    bl_label = "Messages"

    def draw(self, context) -> None:
        for line in steps.messages(context.scene):
            paragraph(self.layout, line.sentence, line.icon, LETTERS)
            if line.remedy:
                draw_remedy(self.layout.row(align=True), line.remedy)


def draw_remedy(row, operator: str) -> None:
    """Draw the button that mends what a message tells, and its other answer if it has two."""
    button(row, operator, icon=REMEDY_ICONS.get(operator, "NONE"))
    if operator == "crowd_lod.take_action":
        row.operator(operator, text="Stand Still", translate=False).still = True


class CROWDLOD_PT_error_curve(_Popover, bpy.types.Panel):
    """Cost of the most expensive frame, by tolerance"""

    bl_label = "Error Against Cost"

    def draw(self, context) -> None:
        settings = context.scene.crowd_lod
        points = possible_budgets(settings)
        fitting = fitting_point(points, budget_of(settings))
        column = self.layout.column()
        label(column, "Least cost of the most expensive frame, by tolerance")
        most = max((point.triangles for point in points), default=1.0)
        for point in points:
            split = column.split(factor=0.2)
            icon = "RIGHTARROW" if point is fitting else "BLANK1"
            label(split, f"{number(point.pixels)} px", icon)
            text = f"{point.triangles:,.0f} triangles, {point.memory / 1e6:,.0f} MB"
            split.progress(factor=point.triangles / max(most, 1.0), text=text, translate=False)
        if fitting is not None:
            label(column, "The arrow marks the least tolerance within the budget", "RIGHTARROW")


CLASSES = (
    CROWDLOD_PT_statistics,
    CROWDLOD_PT_messages,
    CROWDLOD_PT_error_curve,
)
