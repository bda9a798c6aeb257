"""The crowds of a scene: their list in the sidebar, its buttons, and the active one's settings."""

import bpy

from ...crowd_lod.sources.trajectory import Trajectory
from ..blender.operator import Reporting
from ..scene.machine.tracks_source import notes_on_frames
from ..scene.sources.spawn_source import SPAWNING
from ..settings import needs
from ..settings.crowds import active_crowd, add_crowd, index_of_active, set_lengths
from ..viewport import viewport_overlay
from .drawing import active_column, button, label
from .settings_list import Removing
from .step_panel import StepPanel

# who moves the agents of a source that has neither label map nor state machine
MOVERS = {
    "FILE": "The file moves the agents",
    "POINTS": "The object moves the agents",
    "SIMULATION": "Their goals move the agents: see Simulation",
}


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
    """Add a crowd with settings of its own: one plan covers all crowds"""

    bl_idname = "crowd_lod.add_crowd"
    bl_label = "Add Crowd"

    def run(self, context) -> str:
        settings = context.scene.crowd_lod
        set_lengths(context.scene)
        before = active_crowd(settings)
        ground = None if before is None else ((*before.center,), (*before.size,))
        crowd = add_crowd(settings)
        if ground is not None:
            crowd.center, crowd.size = ground
            crowd.count = 100
            crowd.seed = len(settings.crowds)
        settings.crowd_index = len(settings.crowds) - 1
        return f"{crowd.name} is added: choose its source and place."


class CROWDLOD_OT_remove_crowd(Removing, bpy.types.Operator):
    """Remove the active crowd; the agents of crowds after it get other numbers"""

    bl_idname = "crowd_lod.remove_crowd"
    bl_label = "Remove Crowd"
    kind = "crowd"
    needs = (needs.crowds,)


class OfCrowd(StepPanel):
    """A panel of the active crowd, which `crowd(context, layout, crowd)` draws."""

    @classmethod
    def poll(cls, context) -> bool:
        return len(context.scene.crowd_lod.crowds) > 0

    def body(self, context, layout, settings) -> None:
        self.crowd(context, layout, active_crowd(settings))


def parts_shown(scene: bpy.types.Scene) -> list[Trajectory]:
    """Return the trajectory of each crowd up to the active one, as the overlay shows them.

    [] if it does not show the active one.
    """
    frame = viewport_overlay.latest(scene)
    parts = frame.trajectory.parts if frame is not None else ()
    index = index_of_active(scene.crowd_lod)
    return list(parts[: index + 1]) if index < len(parts) else []


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
    if crowd.source == "SIMULATION":
        button(layout, "crowd_lod.simulate", icon="MOD_PHYSICS")
    layout.prop(crowd, "seed")
    active_column(layout, crowd.source != "POINTS").prop(crowd, "center")
    stretched = crowd.source == "FILE" and crowd.height_image is not None  # over the crowd's ground
    active_column(layout, crowd.source in SPAWNING or stretched).prop(crowd, "size")


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
    column = active_column(layout, crowd.source in SPAWNING)
    label(column, "Label Map")
    column.template_ID(crowd, "map_image", open="image.open")
    label(column, "State Machine")
    column.template_ID(crowd, "machine", new="text.new", open="text.open")


CLASSES = (
    CROWDLOD_UL_crowds,
    CROWDLOD_OT_add_crowd,
    CROWDLOD_OT_remove_crowd,
)
