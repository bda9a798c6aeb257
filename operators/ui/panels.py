"""What is on top of the sidebar: the state of the work, and what comes next."""

import textwrap

import bpy

from ...crowd_lod.format import counted
from ..deliver.update_all import due_steps
from ..settings import needs
from . import steps
from .drawing import button, label, letters_of
from .manual import help_address
from .popovers import draw_remedy
from .step_panel import Sidebar

LINES = 2  # of the state; as many whatever it says, so that the buttons below stand still


class CROWDLOD_PT_main(Sidebar, bpy.types.Panel):
    bl_label = "Crowd LOD"

    def draw_header_preset(self, context) -> None:
        row = self.layout.row()
        row.emboss = "NONE"
        row.popover("CROWDLOD_PT_presets", text="", icon="PRESET")
        row.operator("wm.url_open", text="", icon="HELP").url = help_address("The sidebar")

    def draw(self, context) -> None:
        scene = context.scene
        told = steps.messages(scene)
        column = self.layout.column(align=True)
        _draw_state(column, told, letters_of(context))
        if told and told[0].remedy:
            draw_remedy(column.row(align=True), told[0].remedy)
        row = column.split(factor=0.76, align=True)
        _draw_update(row, scene)
        warnings = sum(line.icon == "ERROR" for line in told)
        row.popover("CROWDLOD_PT_messages", text=f"{warnings or ''}", icon="INFO", translate=False)


def _draw_state(layout, told: list[steps.Told], letters: int) -> None:
    """Draw the most urgent line; the popover of all messages has what does not fit."""
    sentence, icon, _ = told[0] if told else steps.Told("Done: the shot is verified", "CHECKMARK")
    lines = textwrap.wrap(sentence, max(20, letters), max_lines=LINES, placeholder=" ...")
    column = layout.column(align=True)
    column.alert = icon == "ERROR"
    for line, text in enumerate([*lines, ""][:LINES]):
        label(column, text, "BLANK1" if line else icon)


def _draw_update(layout, scene: bpy.types.Scene) -> None:
    """Draw the button that does all steps which are due; gray where none is."""
    row = layout.row(align=True)
    text = "Update All"
    if not (needs.crowd(scene) or needs.camera(scene)):
        due = due_steps(scene)
        row.enabled = bool(due)
        text = f"Update All: {counted(len(due), 'step')}" if due else "All Up to Date"
    button(row, "crowd_lod.update_all", text, "FILE_REFRESH", steps.next_operator(scene))


CLASSES = (CROWDLOD_PT_main,)
