"""The operator that renders the viewport's picture with the crowd.

Blender's own Render Viewport Image does not call the draw handlers of add-ons.
"""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ..blender import cameras, image_data
from ..blender.guard import guard
from ..blender.operator import Stepwise
from ..settings import needs
from . import viewport_overlay, visibility
from .playblast import Canvas, camera_matrices


class CROWDLOD_OT_render_viewport(Stepwise, bpy.types.Operator):
    """Render the viewport with the crowd; in camera view, at the size of a render"""

    bl_idname = "crowd_lod.render_viewport"
    bl_label = "Render Viewport Image"
    needs = (needs.overlay, viewport_overlay.undrawn)

    @classmethod
    def poll(cls, context):
        if context.area is None or context.area.type != "VIEW_3D":
            cls.poll_message_set("Put the mouse over a 3D viewport.")
            return False
        return super().poll(context)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        context = bpy.context  # of the viewport in which the button was pressed
        display = viewport_overlay.display_of(scene)
        space = context.space_data
        if display.batches is None:
            raise CrowdError(f"The viewport shows no crowd: {display.problem}")
        region = next(region for region in context.area.regions if region.type == "WINDOW")
        view, projection, size = _viewport_view(context, space, region)
        settings = scene.crowd_lod
        canvas = Canvas(size)
        crowd = visibility.shows_crowd(settings, space) and not visibility.shows_build(
            settings, context.view_layer, space
        )
        try:
            with _waiting(context.window):
                batches = display.batches if crowd else None
                pixels = canvas.picture(
                    scene, context.view_layer, (space, region), (view, projection), batches
                )
        finally:
            canvas.free()
        yield 1.0
        image = image_data.write_image("Viewport with crowd", pixels[..., :3])
        if not bpy.app.background:
            bpy.app.timers.register(partial(show_image, image.name))
        return f"{image.name}: {size[0]} x {size[1]} pixels."


@contextmanager
def _waiting(window: bpy.types.Window | None) -> Iterator[None]:
    """Show a wait cursor: one call of Blender's takes seconds where there is no graphics card."""
    if window is None:
        yield
        return
    window.cursor_modal_set("WAIT")
    try:
        yield
    finally:
        window.cursor_modal_restore()


def _viewport_view(context, space, region) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Return (view, projection, size in pixels) of the viewport's picture."""
    view_3d = space.region_3d
    camera = space.camera
    if view_3d.view_perspective == "CAMERA" and camera is not None and camera.type == "CAMERA":
        depsgraph = context.evaluated_depsgraph_get()
        render = context.scene.render
        size = cameras.image_size(render)
        return *camera_matrices(camera, depsgraph, render, size), size
    view, projection = (
        np.array(matrix, np.float64) for matrix in (view_3d.view_matrix, view_3d.window_matrix)
    )
    return view, projection, (region.width, region.height)


@guard
def show_image(name: str) -> None:
    """Open the image, if it is still there, in a new window.

    A timer calls this. An operator with a progress bar that opens a window never ends, in Blender
    5.2.
    """
    image = bpy.data.images.get(name)
    if image is None:
        return
    bpy.ops.wm.window_new()
    area = bpy.context.window_manager.windows[-1].screen.areas[0]
    area.type = "IMAGE_EDITOR"
    area.spaces.active.image = image


CLASSES = (CROWDLOD_OT_render_viewport,)
