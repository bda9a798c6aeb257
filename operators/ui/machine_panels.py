"""The state machine editor: lists of states, of the rules of one of them, and of labels.

It only draws.
"""

import textwrap

import bpy
import numpy as np

from ..blender import scene_cache
from ..blender.labeled_properties import CONTEXT
from ..scene.machine import map_areas
from ..scene.machine.machine_editor import (
    cell_of,
    draft_of,
    faulty,
    missing_text,
    problem_of,
    selected_name,
)
from ..scene.machine.machine_settings import MOST_TARGETS, color_of, rows_of
from ..scene.machine.map_painting import map_of
from ..settings.crowds import active_crowd
from ..viewport import viewport_overlay
from .area_list import draw_areas
from .crowd_list import OfCrowd, parts_shown
from .drawing import label, letters_of, paragraph, swatch
from .settings_list import draw_row_buttons

MOST_LETTERS = 180  # of a mistake's description; Populate shows all of it
ARROWS = "→↗↑↖←↙↓↘"  # from +x, counter-clockwise
# Of each scene the frame whose agents were counted last, and how many are in each of its states.
_counted: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)


def counts_of(scene: bpy.types.Scene, states: list[str]) -> list[int]:
    """Return how many of the active crowd are in each state at the frame that the overlay shows.

    [] if that is not known.
    """
    parts = parts_shown(scene)
    if not parts or list(parts[-1].states.names) != states:
        return []
    frame = viewport_overlay.latest(scene)
    if _counted.get(scene.session_uid, (None,))[0] is not frame:
        _counted[scene.session_uid] = frame, np.bincount(frame.crowd.state, minlength=256).tolist()
    before = sum(len(part.states.names) for part in parts[:-1])
    return _counted[scene.session_uid][1][before : before + len(states)]


class _List:
    """A list whose rows are drawn from the active crowd's text."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        self.item(context, row, item.name, index)


class CROWDLOD_UL_states(_List, bpy.types.UIList):
    """One state a row: its color, its name, and how many agents are in it."""

    def item(self, context, row, name: str, index: int) -> None:
        draft = draft_of(context.scene)
        row.alert = draft.faulty("states", name)
        counts = counts_of(context.scene, draft.states)
        row.label(
            text=name,
            icon_value=swatch(color_of(draft.state(name).get("color", "#808080"))),
            translate=False,
        )
        count = row.row()
        count.alignment = "RIGHT"
        label(count, f"{counts[index]:,}" if index < len(counts) else "-")


class CROWDLOD_UL_rules(_List, bpy.types.UIList):
    """One label a row: what the selected state does on it, and what follows."""

    def item(self, context, row, name: str, index: int) -> None:
        draft = draft_of(context.scene)
        state = selected_name(context.scene, "states")
        row.alert = draft.faulty("states", state, "on", name)
        row.active = draft.has_rule(state, name)
        split = row.split(factor=0.42)
        color = draft.label(name).get("color", "#808080")
        if name == "*":
            label(split, "others", "BLANK1")
        else:
            split.label(text=name, icon_value=swatch(color_of(color)), translate=False)
        split = split.split(factor=0.57)
        label(split, _following(draft.targets(state, name), state))
        speed, heading = draft.speed(state, name)
        label(split, f"{speed:.3g} {ARROWS[round(heading / 45) % 8]}" if speed else "stands")


class CROWDLOD_UL_labels(_List, bpy.types.UIList):
    """One label a row: its color and its name."""

    def item(self, context, row, name: str, index: int) -> None:
        entry = draft_of(context.scene).label(name)
        row.alert = faulty(context.scene, "labels", name)
        row.operator("crowd_lod.paint_label", text="", icon="BRUSH_DATA", emboss=False).label = name
        row.label(
            text=name, icon_value=swatch(color_of(entry.get("color", "#808080"))), translate=False
        )


def _following(targets: list, state: str) -> str:
    """Return in few words what follows the state."""
    if len(targets) > 1:
        return f"{len(targets)} states"
    return "stays" if targets[0][0] == state else targets[0][0]


def _problem(context, layout) -> None:
    """Draw the mistake of the text, or a line that it has none."""
    sentence = problem_of(context.scene) or missing_text(context.scene)
    if sentence:
        paragraph(
            layout,
            textwrap.shorten(sentence, MOST_LETTERS, placeholder=" ..."),
            "ERROR",
            letters_of(context),
        )


def _list(context, layout, kind: str, names: list[str], rows: int) -> None:
    """Draw a list and, for states and labels, its buttons."""
    row = layout.row()
    row.use_property_split = False
    editor = context.scene.crowd_lod_editor
    row.template_list(
        f"CROWDLOD_UL_{kind}",
        "",
        rows_of(context, kind, names),
        kind,
        editor,
        f"{kind[:-1]}_index",
        rows=rows,
    )
    if kind == "rules":
        return
    draw_row_buttons(row, kind, bool(names), copies=True)


class _Editor(OfCrowd):
    """A panel that edits the active crowd's state machine, which `editor(...)` draws."""

    bl_parent_id = "CROWDLOD_PT_behavior"

    def crowd(self, context, layout, crowd) -> None:
        draft = draft_of(context.scene)
        if draft.states and not missing_text(context.scene):
            rows_of(context, "states", draft.states)
            self.editor(context, layout, context.scene.crowd_lod_editor, draft)
        _problem(context, layout)


class _OfStates(_Editor):
    """A panel of states, which move no other crowds."""

    @classmethod
    def poll(cls, context) -> bool:
        crowd = active_crowd(context.scene.crowd_lod)
        return crowd is not None and crowd.source == "MACHINE"


class CROWDLOD_PT_states(_OfStates, bpy.types.Panel):
    bl_label = "States"

    def editor(self, context, layout, editor, draft) -> None:
        _list(context, layout, "states", draft.states, 5)
        state = selected_name(context.scene, "states")

        def field(name: str, path: str = "") -> None:
            row = layout.row()
            row.alert = bool(path) and draft.faulty("states", state, path)
            row.prop(editor, name)

        field("state_name")
        field("state_color", "color")
        field("start", "start")
        field("action", "action")
        field("fade", "fade")
        field("use_timer", "after")
        if editor.use_timer:
            column = layout.column(align=True)
            column.alert = draft.faulty("states", state, "after")
            column.prop(editor, "timer_least")
            column.prop(editor, "timer_most")
            column = layout.column(align=True)
            column.alert = draft.faulty("states", state, "then")
            _draw_targets(context, column, draft.targets(state, None), "then")
        layout.prop(editor, "edge")


class CROWDLOD_PT_rules(_OfStates, bpy.types.Panel):
    bl_label = "Rules of State"

    def editor(self, context, layout, editor, draft) -> None:
        state, row = cell_of(context.scene)
        label(layout, state)
        _list(context, layout, "rules", draft.rows(state), 5)
        column = layout.column(align=True)
        if row != "*":
            column.prop(editor, "own_rule")
        if not draft.has_rule(state, row):
            return
        walk = column.column(align=True)
        walk.alert = any(
            draft.faulty("states", state, "on", row, field)
            for field in ("move", "speed", "heading")
        )
        walk.prop(editor, "speed")
        walk.prop(editor, "heading")
        following = column.column(align=True)
        following.alert = draft.faulty("states", state, "on", row, "next")
        _draw_targets(context, following, draft.targets(state, row), "next")


def _draw_targets(context, column, targets: list, name: str) -> None:
    """Draw the states that follow, and a menu that adds one.

    One state is drawn as a choice, several with their weights.
    """
    editor = context.scene.crowd_lod_editor
    rows = context.window_manager.crowd_lod_rows
    if len(targets) == 1:
        row = column.row(align=True)
        row.prop_search(editor, f"{name}_state", rows, "states")
        row.menu(f"CROWDLOD_MT_{name}", text="", icon="ADD")
        return
    for n, (target, _) in enumerate(targets[:MOST_TARGETS]):
        row = column.row(align=True)
        row.prop(editor, f"{name}_weights", index=n, text=target, translate=False)
        button = row.operator("crowd_lod.machine_follow", text="", icon="X")
        button.state = target
        button.remove = True
        button.timer = name == "then"
    column.menu(f"CROWDLOD_MT_{name}", icon="ADD")


class _Adding:
    bl_label = "Add State"
    bl_translation_context = CONTEXT
    timer = False

    def draw(self, context) -> None:
        draft = draft_of(context.scene)
        state, row = cell_of(context.scene)
        targets = {name for name, _ in draft.targets(state, None if self.timer else row)}
        for name in draft.states:
            if name not in targets:
                button = self.layout.operator(
                    "crowd_lod.machine_follow", text=name, translate=False
                )
                button.state = name
                button.timer = self.timer


class CROWDLOD_MT_next(_Adding, bpy.types.Menu):
    """Add a state that may follow on the label; one of them is drawn by weight"""


class CROWDLOD_MT_then(_Adding, bpy.types.Menu):
    """Add a state that may follow after the timer; one of them is drawn by weight"""

    timer = True


class CROWDLOD_PT_labels(_Editor, bpy.types.Panel):
    bl_label = "Labels and Map"

    def editor(self, context, layout, editor, draft) -> None:
        _list(context, layout, "labels", draft.labels, 5)
        name = selected_name(context.scene, "labels")
        column = layout.column()
        column.alert = draft.faulty("labels", name)
        for field in ("label_name", "label_color", "spawn"):
            column.prop(editor, field)
        layout.operator("crowd_lod.new_map", icon="ADD")
        if map_of(context.scene) is not None:
            layout.prop(editor, "show_map")


class CROWDLOD_PT_areas(OfCrowd, bpy.types.Panel):
    bl_label = "Walls and Areas"
    bl_parent_id = "CROWDLOD_PT_behavior"

    def crowd(self, context, layout, crowd) -> None:
        rows_of(context, "labels", draft_of(context.scene).labels)
        draw_areas(layout, context, crowd)
        if trouble := map_areas.trouble_of(context.scene):
            paragraph(layout, trouble, "ERROR", letters_of(context))


CLASSES = (
    CROWDLOD_UL_states,
    CROWDLOD_UL_rules,
    CROWDLOD_UL_labels,
    CROWDLOD_MT_next,
    CROWDLOD_MT_then,
    CROWDLOD_PT_states,
    CROWDLOD_PT_rules,
    CROWDLOD_PT_labels,
    CROWDLOD_PT_areas,
)
