"""Goals of the active crowd's simulation: their list in the sidebar."""

import bpy

from ..scene.machine.scene_world import machine_of
from ..scene.sources.simulation_sites import lacking
from ..settings.crowd_settings import may_be_goal
from ..settings.crowds import active_or_new
from .drawing import button, label, wide
from .settings_list import SettingsList, draw_list


class CROWDLOD_UL_goals(bpy.types.UIList):
    """One goal a row: its name, where it is, and its share."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "name", text="", emboss=False)
        row.label(text=item.object.name if item.object else item.label, translate=False)
        row.prop(item, "is_exit", text="", icon="CHECKMARK" if item.is_exit else "PAUSE")


def _add(context) -> str:
    crowd = active_or_new(context.scene.crowd_lod)
    items = [item for item in context.selected_objects if may_be_goal(item)]
    for item in items or [None]:
        goal = crowd.goals.add()
        goal.object = item
        labels = machine_of(crowd).labels
        goal.label = "" if item or "exit" not in labels else "exit"
        goal.name = item.name if item else goal.label.capitalize() or "Goal"
    context.scene.crowd_lod_editor.goal_index = len(crowd.goals) - 1
    if not items:
        return "Choose an object or a label for the goal."
    return f"Added as goals: {', '.join(item.name for item in items)}."


GOALS = SettingsList(
    "goal",
    {
        "add": "Add the selected objects as goals; without a selection, choose an object or label "
        "later",
        "remove": "Remove the selected goal",
        "move": "Move the selected goal",
    },
    _add,
    of_crowd=True,
)


def draw_simulation(layout, context, crowd) -> None:
    """Draw the settings of a simulated crowd and its button."""
    editor = context.scene.crowd_lod_editor
    label(layout, "Goals")
    draw_list(layout, crowd, "goal", editor, rows=3)
    if len(crowd.goals):
        goal = crowd.goals[min(editor.goal_index, len(crowd.goals) - 1)]
        layout.prop(goal, "object")
        if goal.object is None:
            layout.prop_search(goal, "label", context.window_manager.crowd_lod_rows, "labels")
        if crowd.goal_choice == "SHARES":
            layout.prop(goal, "share")
    layout.prop(crowd, "goal_choice")
    wide(layout, crowd, "people_a_minute")
    for name in (
        *("walking_speed", "spawn_labels", "wall_labels", "obstacles"),
        *("waiting_action", "simulated_seconds"),
    ):
        layout.prop(crowd, name)
    button(layout, "crowd_lod.simulate", icon="MOD_PHYSICS")
    if said := lacking():
        label(layout, said, "ERROR")


CLASSES = (CROWDLOD_UL_goals,)
