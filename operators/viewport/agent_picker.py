"""Picking an agent in the viewport, to read what the plan decided about it."""

import bpy
import numpy as np

from ...crowd_lod.frame.reasons import nearest
from ..blender import sidebars
from ..blender.operator import Needing
from ..settings import needs
from . import viewport_overlay

WITHIN = 40.0  # nominal pixels from the cursor


def under(screen: bpy.types.Screen, x: int, y: int) -> bpy.types.Region | None:
    """Return the viewport's main region at the window's pixel (x, y).

    None if there is no viewport, or if another region, such as the sidebar, covers the pixel.
    """
    for area in screen.areas:
        here = [r for r in area.regions if r.x <= x < r.x + r.width and r.y <= y < r.y + r.height]
        if area.type == "VIEW_3D" and here and all(region.type == "WINDOW" for region in here):
            return here[0]
    return None


class CROWDLOD_OT_inspect(Needing, bpy.types.Operator):
    """Pick an agent in the viewport: see why it is shown or culled, its LOD and cost"""

    bl_idname = "crowd_lod.inspect"
    bl_label = "Inspect Agent"
    bl_options = {"REGISTER"}
    needs = (needs.overlay, viewport_overlay.undrawn)

    def invoke(self, context, event) -> set[str]:
        self._before = context.scene.crowd_lod.agent
        context.window_manager.modal_handler_add(self)
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set("Point at an agent; click to keep it, Esc to cancel")
        return {"RUNNING_MODAL"}

    def modal(self, context, event) -> set[str]:
        settings = context.scene.crowd_lod
        display = viewport_overlay.display_of(context.scene)
        if event.type in ("ESC", "RIGHTMOUSE") or display is None or display.frame is None:
            settings.agent = self._before
            sidebars.redraw_viewports()
            self.cancel(context)
            return {"CANCELLED"}
        region = under(context.window.screen, event.mouse_x, event.mouse_y)
        if region is None or event.type not in ("MOUSEMOVE", "LEFTMOUSE"):
            return {"PASS_THROUGH"}
        if event.type == "LEFTMOUSE":
            self.cancel(context)
            return {"FINISHED"}
        nearest_agent = nearest(
            display.frame.crowd.places(display.frame.trajectory.spheres.center),
            np.array(region.data.perspective_matrix, np.float64),
            (region.width, region.height),
            (event.mouse_x - region.x, event.mouse_y - region.y),
            WITHIN * context.preferences.system.ui_scale,
            display.frame.visible | display.frame.culled
            if settings.overlay_culled
            else display.frame.visible,
        )
        agent = -1 if nearest_agent is None else nearest_agent
        if settings.agent != agent:
            settings.agent = agent
            sidebars.redraw_viewports()
        return {"RUNNING_MODAL"}

    def cancel(self, context) -> None:
        if context.window is not None:  # it may have been closed
            context.window.cursor_modal_restore()
            context.workspace.status_text_set(None)


CLASSES = (CROWDLOD_OT_inspect,)
