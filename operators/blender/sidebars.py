"""The sidebars of all windows' viewports."""

import bpy

from .guard import guard


@guard
def redraw() -> None:
    """Have Blender draw the sidebars anew."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
