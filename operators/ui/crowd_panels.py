"""The panel of the crowds, and its sub-panels: character groups, behavior, ground."""

import bpy

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.format import counted
from ..scene.machine.machine_editor import draft_of
from ..scene.machine.machine_settings import rows_of
from ..scene.machine.tracks_source import notes_on_frames
from ..scene.sources.spawn_source import ON_OBJECT, SPAWNING
from ..settings.crowds import active_crowd
from ..settings.level_settings import CrowdLodGroup
from .action_menu import draw_action
from .crowd_list import OfCrowd, parts_shown
from .drawing import button, data_block, label, length, letters_of, paragraph, speed
from .goal_list import draw_simulation
from .group_list import draw_groups
from .settings_list import draw_list
from .step_panel import StepPanel


class CROWDLOD_PT_crowd(StepPanel, bpy.types.Panel):
    bl_label = "Crowd"
    bl_options = set()

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        if scene.crowd_lod.characters is None:
            return "crowd_lod.characters_from_selection", "From Selection"
        return "crowd_lod.populate", "Populate"

    def body(self, context, layout, settings) -> None:
        draw_list(layout, settings, "crowd", settings, rows=2)
        layout.prop(settings, "characters")
        if settings.characters is not None:
            button(layout, "crowd_lod.characters_from_selection", icon="RESTRICT_SELECT_OFF")
        layout.prop(settings, "forward")
        crowd = active_crowd(settings)
        if crowd is not None:
            _draw_source(layout, crowd)


def _draw_source(layout, crowd) -> None:
    """Draw who moves the agents of a crowd, how many there are, and where they start."""
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
        _draw_start(layout, crowd)
    layout.prop(crowd, "seed")
    if crowd.source != "POINTS":
        layout.prop(crowd, "first_frame")
        layout.prop(crowd, "center")
    stretched = crowd.source == "FILE" and crowd.height_image is not None  # over the crowd's ground
    if crowd.source in SPAWNING or stretched:
        layout.prop(crowd, "size")


def _draw_start(layout, crowd) -> None:
    """Draw where the agents of a crowd start."""
    layout.prop(crowd, "spawn_on")
    if crowd.spawn_on in ON_OBJECT:
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
        for name in ("rows", "row_depth", "row_rise"):
            layout.prop(crowd, name)
        if crowd.face is None:
            layout.prop(crowd, "row_turn")
    if crowd.source == "MACHINE" and crowd.spawn_on in ON_OBJECT:
        layout.prop(crowd, "face")


class CROWDLOD_PT_groups(StepPanel, bpy.types.Panel):
    bl_label = "Character Groups"
    bl_parent_id = "CROWDLOD_PT_crowd"

    @classmethod
    def poll(cls, context) -> bool:
        return len(context.scene.crowd_lod.groups) > 0

    def body(self, context, layout, settings) -> None:
        several = sum(not group.variant_of for group in settings.groups) > 1
        crowd = active_crowd(settings)
        if crowd is not None and several:
            layout.prop(crowd, "group_names")
        group = draw_groups(layout, context.scene)
        _draw_measured(context, layout, group)
        draw_action(layout, context.scene, group)
        if several:
            layout.prop(group, "share")
        layout.row().prop(group, "scale")
        if group.lowest:
            layout.prop(group, "on_ground")
        button(layout, "crowd_lod.take_action", icon="ACTION")
        button(layout, "crowd_lod.give_lod", icon="MOD_DECIM")


def _draw_measured(context, layout, group: bpy.types.PropertyGroup) -> None:
    """Draw what Populate measured of a group."""
    found = [f"Radius {length(context, group.radius)}"]
    found.append(f"stride {length(context, group.stride)}" if group.stride else "plays by time")
    if way := group.stride or group.way:
        found.append(speed(context, way, group.period))
    paragraph(layout, ", ".join(found), "INFO", letters_of(context))
    if group.way and not group.stride:
        kinds = CrowdLodGroup.bl_rna.properties["plays"].enum_items
        paragraph(layout, kinds[group.plays].description, "INFO", letters_of(context))


class CROWDLOD_PT_behavior(OfCrowd, bpy.types.Panel):
    bl_label = "Behavior"

    @classmethod
    def poll(cls, context) -> bool:
        crowd = active_crowd(context.scene.crowd_lod)
        return crowd is not None and crowd.source in SPAWNING

    def crowd(self, context, layout, crowd) -> None:
        data_block(layout, crowd, "map_image", open="image.open")
        data_block(layout, crowd, "machine", new="text.new", open="text.open")
        layout.menu("CROWDLOD_MT_machine_presets", icon="PRESET")
        if crowd.source == "SIMULATION":
            rows_of(context, "labels", draft_of(context.scene).labels)
            draw_simulation(layout, context, crowd)
            return
        parts = parts_shown(context.scene)
        machine = parts[-1].machine if parts and isinstance(parts[-1], Walk) else None
        if machine is not None:
            states = counted(len(machine.states), "state")
            labels = counted(len(machine.labels), "label")
            label(layout, f"{states}, {labels}; edge: {machine.edge}", "INFO")


class CROWDLOD_PT_ground(OfCrowd, bpy.types.Panel):
    bl_label = "Ground"

    @classmethod
    def poll(cls, context) -> bool:
        crowd = active_crowd(context.scene.crowd_lod)
        return crowd is not None and crowd.source != "POINTS"  # these have their heights

    def crowd(self, context, layout, crowd) -> None:
        for name in ("terrain", "terrain_object"):
            layout.prop(crowd, name)
        has_terrain = crowd.terrain is not None or crowd.terrain_object is not None
        if not has_terrain:
            data_block(layout, crowd, "height_image", open="image.open")
            if crowd.height_image is not None:
                layout.prop(crowd, "height_scale")
        if has_terrain or crowd.height_image is not None:
            layout.prop(crowd, "tilt")


CLASSES = (
    CROWDLOD_PT_crowd,
    CROWDLOD_PT_groups,
    CROWDLOD_PT_behavior,
    CROWDLOD_PT_ground,
)
