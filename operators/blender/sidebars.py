"""The viewports of all windows, and their sidebars."""

from collections.abc import Iterator

import bpy

from .callbacks import guard


@guard
def redraw() -> None:
    """Have Blender draw the sidebars anew."""
    for area in _viewports():
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def redraw_viewports() -> None:
    """Have Blender draw all viewports anew, with their sidebars."""
    for area in _viewports():
        area.tag_redraw()


def _viewports() -> Iterator[bpy.types.Area]:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                yield area
