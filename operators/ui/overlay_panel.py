"""The panel of the overlay."""

import bpy

from ..viewport import viewport_overlay
from .agent_overrides import draw_agent_overrides
from .step_panel import StepPanel


class CROWDLOD_PT_overlay(StepPanel, bpy.types.Panel):
    bl_label = "Overlay"

    def draw_header(self, context) -> None:
        self.layout.prop(context.scene.crowd_lod, "overlay", text="")

    def body(self, context, layout, settings) -> None:
        if not settings.overlay:
            return
        layout.popover("CROWDLOD_PT_statistics", text=_line(context.scene), translate=False)
        for name in (
            "overlay_camera",
            "overlay_mode",
            "overlay_color",
            "overlay_culled",
            "hud",
            "inset",
        ):
            layout.prop(settings, name)
        row = layout.row(align=True)
        row.prop(settings, "agent")
        row.operator("crowd_lod.inspect", text="", icon="EYEDROPPER")
        if settings.agent >= 0:
            draw_agent_overrides(layout)
        layout.operator("crowd_lod.render_viewport", icon="RENDER_STILL")


def _line(scene: bpy.types.Scene) -> str:
    """Return the frame's figures in one line."""
    frame = viewport_overlay.latest(scene)
    if frame is None:
        return "Statistics"
    visible = len(frame.without_worn(frame.buckets).order)
    counts = f"{visible:,} of {frame.people:,} visible"
    return (
        f"{counts}, {frame.triangles / frame.full_triangles:.0%} of triangles"
        if frame.full_triangles
        else counts
    )


CLASSES = (CROWDLOD_PT_overlay,)
