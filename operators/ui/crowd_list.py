"""The further crowds of a scene: their list in the sidebar, and its buttons."""

import bpy

from ..blender.operator import Reporting
from ..settings import needs
from ..sources.jupedsim_run import has_jupedsim
from ..sources.tracks_source import notes_on_frames
from .drawing import active_column, button, label
from .settings_list import Removing, draw_list
from .step_panel import StepPanel

# who moves the agents of a source that has neither label map nor state machine
MOVERS = {"FILE": "The file moves the agents", "POINTS": "The object moves the agents"}


class CROWDLOD_UL_crowds(bpy.types.UIList):
    """One crowd a row: whether it is there, its name and its size."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "name", text="", emboss=False)
        row.prop(
            item,
            "use_crowd",
            text="",
            icon="HIDE_OFF" if item.use_crowd else "HIDE_ON",
            emboss=False,
        )


class CROWDLOD_OT_add_crowd(Reporting, bpy.types.Operator):
    """Add a crowd beside those that are there, with settings of its own"""

    bl_idname = "crowd_lod.add_crowd"
    bl_label = "Add Crowd"
    needs = (needs.characters,)

    def run(self, context) -> str:
        settings = context.scene.crowd_lod
        number = len(settings.crowds) + 2
        taken = {each.name for each in settings.crowds}
        while f"Crowd {number}" in taken:
            number += 1
        crowd = settings.crowds.add()
        crowd.name = f"Crowd {number}"
        crowd.count = 100
        crowd.seed = number
        crowd.center = settings.center
        crowd.size = settings.size
        settings.crowd_index = len(settings.crowds) - 1
        return f"{crowd.name} is added: choose its source and place."


class CROWDLOD_OT_remove_crowd(Removing, bpy.types.Operator):
    """Remove the selected crowd; the agents of crowds after it get other numbers"""

    bl_idname = "crowd_lod.remove_crowd"
    bl_label = "Remove Crowd"
    kind = "crowd"
    needs = (needs.further_crowds,)


class CROWDLOD_PT_crowds(StepPanel, bpy.types.Panel):
    bl_label = "Further Crowds"
    bl_parent_id = "CROWDLOD_PT_crowd"

    def body(self, context, layout, settings) -> None:
        draw_list(layout, settings, "crowd", settings, rows=2)
        if not len(settings.crowds):
            label(layout, "One plan covers all crowds", "INFO")
            return
        crowd = settings.crowds[_selected(settings)]
        draw_source(layout, crowd)
        if len(settings.groups) > 1:
            layout.prop(crowd, "group_names")


class _OfCrowd(StepPanel):
    """A sub-panel of the selected further crowd; `crowd(layout, crowd, index)` draws it."""

    bl_parent_id = "CROWDLOD_PT_crowds"

    @classmethod
    def poll(cls, context) -> bool:
        return len(context.scene.crowd_lod.crowds) > 0

    def body(self, context, layout, settings) -> None:
        index = _selected(settings)
        self.crowd(layout, settings.crowds[index], index + 1)


class CROWDLOD_PT_crowd_behavior(_OfCrowd, bpy.types.Panel):
    bl_label = "Behavior of Crowd"

    def crowd(self, layout, crowd, index: int) -> None:
        draw_behavior(layout, crowd)
        active_column(layout, crowd.source != "POINTS").prop(crowd, "first_frame")
        label(layout, MOVERS.get(crowd.source, "The machine moves the agents"), "INFO")


class CROWDLOD_PT_crowd_ground(_OfCrowd, bpy.types.Panel):
    bl_label = "Ground of Crowd"

    def crowd(self, layout, crowd, index: int) -> None:
        draw_ground(layout, crowd)


class CROWDLOD_PT_crowd_simulation(_OfCrowd, bpy.types.Panel):
    bl_label = "Simulation of Crowd"

    @classmethod
    def poll(cls, context) -> bool:
        return super().poll(context) and has_jupedsim()

    def crowd(self, layout, crowd, index: int) -> None:
        draw_simulation(layout, crowd, index)


def _selected(settings) -> int:
    """Return the index of the further crowd whose settings are shown."""
    return min(settings.crowd_index, len(settings.crowds) - 1)


def draw_source(layout, crowd) -> None:
    """Draw who moves the agents of a crowd, and where it is."""
    layout.prop(crowd, "source")
    if crowd.source == "FILE":
        for name in ("tracks_file", "tracks_columns", "tracks_unit", "tracks_rate", "tracks_up"):
            layout.prop(crowd, name)
        label(layout, notes_on_frames(crowd), "INFO")
    elif crowd.source == "POINTS":
        layout.prop(crowd, "points")
        button(layout, "crowd_lod.record_points", icon="REC")
    else:
        layout.prop(crowd, "count")
        draw_start(layout, crowd)
    layout.prop(crowd, "seed")
    active_column(layout, crowd.source != "POINTS").prop(crowd, "center")
    stretched = crowd.source == "FILE" and crowd.height_image is not None  # over the crowd's ground
    active_column(layout, crowd.source == "MACHINE" or stretched).prop(crowd, "size")


def draw_start(layout, crowd) -> None:
    """Draw where the agents of a crowd start."""
    layout.prop(crowd, "spawn_on")
    if crowd.spawn_on in ("SURFACE", "CURVES", "POINTS"):
        layout.prop(crowd, "spawn_object")
    if crowd.spawn_on == "SURFACE":
        item = crowd.spawn_object
        if item is not None and item.type == "MESH":
            layout.prop_search(crowd, "density_group", item, "vertex_groups")
        for name in ("density_image", "density_volumes"):
            layout.prop(crowd, name)
    if crowd.spawn_on in ("GRID", "CURVES"):
        layout.prop(crowd, "spacing")
    if crowd.spawn_on == "CURVES":
        for name in ("rows", "row_depth", "row_rise", "row_turn"):
            layout.prop(crowd, name)


def draw_ground(layout, crowd) -> None:
    """Draw what the agents of a crowd stand on; grayed where their heights are those of points."""
    whole = active_column(layout, crowd.source != "POINTS")
    for name in ("terrain", "terrain_object"):
        whole.prop(crowd, name)
    terrain = crowd.terrain is not None or crowd.terrain_object is not None
    column = active_column(whole, not terrain)
    label(column, "Height Map")
    column.template_ID(crowd, "height_image", open="image.open")
    active_column(column, crowd.height_image is not None).prop(crowd, "height_scale")
    active_column(whole, terrain or crowd.height_image is not None).prop(crowd, "tilt")
    if crowd.source == "POINTS":
        label(layout, "The points have their heights", "INFO")


def draw_behavior(layout, crowd) -> None:
    """Draw what the agents of a crowd do; grayed where a file or an object moves them."""
    column = active_column(layout, crowd.source == "MACHINE")
    label(column, "Label Map")
    column.template_ID(crowd, "map_image", open="image.open")
    label(column, "State Machine")
    column.template_ID(crowd, "machine", new="text.new", open="text.open")


def draw_simulation(layout, crowd, index: int) -> None:
    """Draw the settings of Simulate with JuPedSim and its button, for the crowd `index`."""
    for name in (
        "spawn_labels",
        "goal_labels",
        "goal_choice",
        "wall_labels",
        "obstacles",
        "simulated_seconds",
    ):
        layout.prop(crowd, name)
    made = button(layout, "crowd_lod.simulate", icon="MOD_PHYSICS")
    if made is not None:
        made.crowd = index


CLASSES = (
    CROWDLOD_UL_crowds,
    CROWDLOD_OT_add_crowd,
    CROWDLOD_OT_remove_crowd,
    CROWDLOD_PT_crowds,
    CROWDLOD_PT_crowd_behavior,
    CROWDLOD_PT_crowd_ground,
    CROWDLOD_PT_crowd_simulation,
)
