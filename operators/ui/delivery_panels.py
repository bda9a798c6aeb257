"""The panels of what the shot becomes: its render set-up, its checks, what is handed over."""

from collections.abc import Mapping
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size, counted
from ...crowd_lod.levels.cost_model import NAMES, SEEN
from ..build.character_images import IMAGE_BYTES, can_use_cache
from ..build.render_setup import baked_of
from ..build.visibility import layers_of
from ..deliver.hand_over import Lack, lacks_of, sizes_of
from ..deliver.usd.openusd import missing_openusd
from ..freshness.artifacts import build_artifact, current_proof, stale
from ..freshness.bake_frames import is_bake
from ..settings import needs
from ..settings.stored_figures import costs_of
from .drawing import button, label, letters_of, paragraph, report_button, wide
from .step_panel import StepPanel


class CROWDLOD_PT_build(StepPanel, bpy.types.Panel):
    bl_label = "Render Set-Up"

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        artifact = build_artifact(scene)
        return artifact.operator, f"{'Update ' * bool(stale(scene, artifact))}{artifact.label}"

    def body(self, context, layout, settings) -> None:
        changed = [str(change) for change in stale(context.scene, build_artifact(context.scene))]
        if changed:
            paragraph(layout, f"Changed: {', '.join(changed)}", "FILE_REFRESH", letters_of(context))
        else:
            label(layout, _built(settings.build), "INFO")
        row = layout.row(align=True)
        if is_bake(settings.build):  # the header has the other button
            button(row, "crowd_lod.build", icon="GEOMETRY_NODES")
        else:
            button(row, "crowd_lod.bake", icon="FREEZE")
        row.operator("crowd_lod.remove_build", text="", icon="TRASH")
        wide(layout, settings, "render_source_characters")
        if settings.build is not None and (size := settings.build.get(IMAGE_BYTES)):
            label(layout, f"Images: {byte_size(size)} at full size", "IMAGE_DATA")
            if can_use_cache(context.scene):
                wide(layout, context.scene.render, "use_texture_cache")
                wide(layout, context.scene.render, "use_auto_generate_texture_cache")
        button(layout, "crowd_lod.estimate", icon="MEMORY")
        self.draw_costs(layout.column(align=True), settings)

    def draw_costs(self, layout, settings) -> None:
        """Draw the table of the estimate, once it is made."""
        table = costs_of(settings)
        if table is None:
            return
        self.row(layout, NAMES[table.engine], "Memory", "Time")
        for case, cost in table.costs.items():
            # what is baked is the case above it
            name = "Baked" if case.is_baked else case.title
            self.row(layout, name, byte_size(cost.memory), f"{cost.time:.0%}")
        if table.engine in SEEN:
            ranges = ["{:g} to {:g} x".format(*seen) for seen in SEEN[table.engine]]
            self.row(layout, "Measured", *ranges)

    def row(self, layout, name: str, memory: str, time: str) -> None:
        """Draw a row of the table."""
        row = layout.split(factor=0.42)
        label(row, name)
        row = row.split(factor=0.5)
        label(row, memory)
        label(row, time)


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


class CROWDLOD_PT_check(StepPanel, bpy.types.Panel):
    bl_label = "Check"

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        return "crowd_lod.verify", "Verify"

    def body(self, context, layout, settings) -> None:
        proof = current_proof(context.scene)
        if proof is not None:
            icon = "CHECKMARK" if proof.ok else "ERROR"
            paragraph(layout, proof.sentence, icon, letters_of(context))
            if proof.worst:
                _draw_remedies(layout, proof.worst)
        row = layout.row(align=True)
        row.prop(settings, "verify_count")
        row.operator("crowd_lod.show_proof", text="", icon="IMAGE_DATA")
        report_button(row, "VERIFY")
        layout.separator()
        column = layout.column(align=True)
        column.prop(settings, "step")
        column.prop(settings, "width")
        row = layout.row(align=True)
        button(row, "crowd_lod.preview", icon="RENDER_ANIMATION")
        report_button(row, "PREVIEW")
        row = layout.row(align=True)
        button(row, "crowd_lod.report_error", icon="GRAPH")
        report_button(row, "ERROR")


def _draw_remedies(layout, worst: Mapping[str, Any]) -> None:
    """Draw what mends, or shows, the agent that a proof found farthest off."""
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    show = grid.operator(
        "crowd_lod.go_to_switch",
        text=f"Go to Frame {worst['frame']}",
        icon="VIEWZOOM",
        translate=False,
    )
    show.frame, show.agent = worst["frame"], worst["agent"]
    pin = grid.operator(
        "crowd_lod.override_agent",
        text=f"Pin LOD {max(worst['lod'] - 1, 0)}",
        icon="PINNED",
        translate=False,
    )
    pin.type, pin.agent, pin.level = "ALWAYS", worst["agent"], max(worst["lod"] - 1, 0)
    layout.operator("crowd_lod.use_measured_error", icon="DRIVER_DISTANCE")


class CROWDLOD_PT_hand_over(StepPanel, bpy.types.Panel):
    bl_label = "Hand Over"

    def body(self, context, layout, settings) -> None:
        scene = context.scene
        lacks = [] if needs.crowd(scene) or needs.camera(scene) else _lacks(scene)
        for lack in lacks:
            paragraph(layout, lack.sentence, "ERROR", letters_of(context))
        if not bpy.data.filepath:
            layout.operator("wm.save_mainfile", icon="FILE_TICK")
        sizes = sizes_of(scene)
        if is_bake(settings.build) and (size := sizes.get("crowd_lod.bake")):
            label(layout, f"Baked file: {size}", "FILE")
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
        layout.separator()
        layout.operator("crowd_lod.add_aovs", icon="RENDERLAYERS")


def _lacks(scene: bpy.types.Scene) -> list[Lack]:
    """Return what the outputs still need; what several of them need counts once."""
    outputs = "crowd_lod.bake", "crowd_lod.export_usd", "crowd_lod.write_farm_job"
    return list(dict.fromkeys(lack for name in outputs for lack in lacks_of(scene, name)))


CLASSES = (
    CROWDLOD_PT_build,
    CROWDLOD_PT_view_layers,
    CROWDLOD_PT_check,
    CROWDLOD_PT_hand_over,
)
