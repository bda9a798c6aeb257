"""The playblast: the scene in solid shading, with the overlay drawn over it; and its operator."""

from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.output.file_checks import save_png
from ..blender import cameras, console, image_data
from ..blender.callbacks import guard
from ..blender.colors import to_linear
from ..blender.machine import told_by
from ..blender.operator import Stepwise
from ..scene.scene_crowd import SceneCrowd
from ..settings import needs
from . import character_cache, hud, viewport_overlay, visibility
from .appearance import bodies_of, colors_of, drawing_of, style_of
from .gpu_batches import Batches
from .gpu_draw import paint, put_depth
from .visibility import reveal_hidden, show_as_rendered

# Settings of the scene's Workbench renders that a viewport takes over for a picture.
SHADING = (
    "light color_type show_shadows show_cavity show_object_outline show_xray "
    "show_specular_highlight show_backface_culling"
).split()
GAMMA = 2.2  # of the picture, where Blender's viewports lay overlays over it


class Canvas:
    """Draws pictures on the GPU. Call free() at the end.

    size: (width, height) in pixels.
    """

    def __init__(self, size: tuple[int, int]):
        from gpu.types import GPUFrameBuffer, GPUOffScreen, GPUTexture

        self.size = size
        self._solid = GPUOffScreen(*size)
        # the formats of a viewport's overlays; a framebuffer does not hold on to its textures
        self._textures = (
            GPUTexture(size, format="SRGB8_A8"),
            GPUTexture(size, format="DEPTH_COMPONENT32F"),
        )
        self._overlay = GPUFrameBuffer(color_slots=self._textures[0], depth_slot=self._textures[1])

    def free(self) -> None:
        self._solid.free()
        self._overlay = self._textures = None

    def picture(
        self,
        scene,
        layer,
        viewport: tuple,
        matrices: tuple[np.ndarray, np.ndarray],
        batches: Batches | None,
        caption: str = "",
    ) -> np.ndarray:
        """Return the picture of the scene with the overlay and a caption.

        The view layer is drawn as the viewport shows it. The batches are drawn over it, hidden by
        geometry in front of them, and the caption last.
        Returns (height, width, 4) uint8, sRGB, bottom row first.

        viewport: (space, region).
        matrices: (view, projection), see gpu_draw.paint.
        """
        import gpu
        from mathutils import Matrix

        width, height = self.size
        self._solid.draw_view3d(
            scene,
            layer,
            *viewport,
            *(Matrix(each.tolist()) for each in matrices),
            do_color_management=True,
        )
        with self._solid.bind():
            buffer = gpu.state.active_framebuffer_get()
            picture = self._read(buffer)
            depth = buffer.read_depth(0, 0, width, height)
        with self._overlay.bind():
            self._overlay.clear(color=(0, 0, 0, 0), depth=1.0)
            if batches is not None:
                put_depth(depth, self.size)
                paint(batches, *matrices, self.size, bpy.context.preferences.system.ui_scale)
            if caption:
                self._write(caption)
            over = self._read(self._overlay)
        covered = over[..., 3] > 0
        picture[covered] = _merged(picture[covered], over[covered])
        return picture

    def _read(self, buffer) -> np.ndarray:
        """Return the framebuffer's colors, (height, width, 4) uint8."""
        width, height = self.size
        return np.array(memoryview(buffer.read_color(0, 0, width, height, 4, 0, "UBYTE"))).reshape(
            height, width, 4
        )

    def _write(self, caption: str) -> None:
        import gpu
        from mathutils import Matrix

        width, height = self.size
        to_clip = Matrix.Translation((-1, -1, 0)) @ Matrix.Diagonal((2 / width, 2 / height, 1, 1))
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_matrix(Matrix())
            gpu.matrix.load_projection_matrix(to_clip)
            hud.write(
                [hud.HudLine(caption)], (0, 0, width, height), caption_size(width) / hud.LETTERS
            )


def caption_size(width: int) -> int:
    """Return the pixels of a caption's letters in a picture this wide: read at half its size."""
    return max(8, width // 42)


def _merged(below: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return the colors `over` laid over `below`, as Blender's viewport does it.

    The overlay is blended as linear light, everything else with GAMMA
    (gpu_shader_display_transform).

    below, over: (n, 4) uint8, sRGB; `over` has its alpha multiplied in.
    """
    over = over / np.float32(255)
    light = (below / np.float32(255)) ** GAMMA * (1 - over[:, 3:]) + to_linear(over)
    return np.rint(255 * light.clip(0, 1) ** (1 / GAMMA)).astype(np.uint8)


@contextmanager
def solid_viewport(scene: bpy.types.Scene) -> Iterator[tuple]:
    """Yield (space, region) of a viewport in solid shading; restore it at the end.

    The viewport must show the whole scene; CrowdError if there is none. Its shading is that of the
    scene's Workbench renders, on the world's color.
    """
    areas = (area for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D")
    whole = (
        area
        for area in areas
        if area.spaces[0].local_view is None and not area.spaces[0].use_local_collections
    )
    area = next((area for area in whole if not area.spaces[0].region_3d.use_clip_planes), None)
    if area is None:
        raise CrowdError(
            "The overlay's preview draws with a 3D viewport, and there is none that shows the "
            "whole scene: open one "
            "without local view, local collections and clipping region, or choose another engine."
        )
    space = area.spaces[0]
    own = scene.display.shading
    lent = {name: getattr(own, name) for name in SHADING} | {
        "type": "SOLID",
        "background_type": "WORLD",
        "use_dof": False,
    }
    before = {name: getattr(space.shading, name) for name in lent}
    overlays = space.overlay.show_overlays
    try:
        space.overlay.show_overlays = False
        _set(space.shading, lent)
        yield space, next(region for region in area.regions if region.type == "WINDOW")
    finally:
        _set(space.shading, before)
        space.overlay.show_overlays = overlays


def _set(shading: bpy.types.View3DShading, values: dict) -> None:
    for name, value in values.items():
        setattr(shading, name, value)


class Playblast:
    """Draws the pictures of a preview's stage with the overlay.

    Use it as a context manager: at the end it frees everything it holds.

    crowd: that of the stage.
    size: width and height of the pictures in pixels.
    """

    def __init__(self, crowd: SceneCrowd, size: tuple[int, int]):
        self.crowd = crowd
        self.stage = crowd.scene
        self.size = size
        self.bodies = self.batches = None
        self.notes: tuple[str, ...] = ()

    def __enter__(self):
        self.canvas = Canvas(self.size)
        with ExitStack() as opened:
            opened.callback(self.canvas.free)
            opened.enter_context(reveal_hidden(self.stage))
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_):
        self._opened.close()
        self.bodies = self.batches = None
        character_cache.drop(self.stage)

    def prepare(self) -> Iterator[float]:
        """Read the characters; yield the progress, 0 to 1.

        CrowdError if the characters cannot be drawn as the scene's settings ask.
        """
        yield from character_cache.read(self.stage)
        self.style, self.characters, self.notes = style_of(self.stage, self.crowd.policy.count)
        if self.style.mode != self.stage.crowd_lod.overlay_mode:
            raise CrowdError(" ".join(self.notes))
        self.bodies = bodies_of(self.crowd.trajectory.groups, self.style, self.characters)

    def place(self, frame: Frame) -> None:
        """Upload the frame's agents to the GPU."""
        settings = self.stage.crowd_lod
        colored = colors_of(settings.overlay_color, frame, self.characters)
        # the frustum that is looked along is the picture's edge
        what = drawing_of(settings, frame, self.style, colored, framed=False)
        self.batches = Batches(what, self.bodies)

    def main(self, path: Path, caption: str) -> None:
        """Write the view of the stage's camera to `path`, with the agents."""
        self._draw(path, caption, self.batches)

    def above(self, path: Path, caption: str) -> None:
        """Write the view of the stage's camera to `path`, without the agents."""
        self._draw(path, caption, None)

    def _draw(self, path: Path, caption: str, batches: Batches | None) -> None:
        stage = self.stage
        layer = self.stage.view_layers[0]
        show_as_rendered(layer)
        matrices = camera_matrices(stage.camera, layer.depsgraph, stage.render, self.canvas.size)
        with solid_viewport(stage) as viewport:
            caption = f"Frame {stage.frame_current}  {caption}"
            save_png(path, self.canvas.picture(stage, layer, viewport, matrices, batches, caption))


def camera_matrices(
    camera: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    render: bpy.types.RenderSettings,
    size: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return (view, projection) of the camera's picture of `size` pixels.

    Both are (4, 4) float64, as gpu_draw.paint takes them.
    """
    view = np.linalg.inv(np.array(camera.evaluated_get(depsgraph).matrix_world, np.float64))
    x, y = size
    scale_x = render.pixel_aspect_x
    scale_y = render.pixel_aspect_y
    return view, np.array(
        camera.calc_matrix_camera(depsgraph, x=x, y=y, scale_x=scale_x, scale_y=scale_y), np.float64
    )


def need_gpu() -> None:
    """Start the GPU in background mode; CrowdError if there is none.

    Without a driver, Blender exits instead of raising an error. So another process tries first.
    """
    if not bpy.app.background:
        return
    import gpu

    if bpy.app.version < (5, 1, 0):
        raise CrowdError(
            f"Blender {bpy.app.version_string} has no GPU in background mode: use Blender 5.1 or "
            f"later for the engine overlay, "
            "or another engine."
        )
    if told_by("import bpy, gpu; gpu.init()") is None:
        raise CrowdError(
            "The engine overlay needs OpenGL or Vulkan, and no driver for either starts here: "
            "install one (Mesa works without "
            "a graphics card), or choose another engine."
        )
    with console.quiet():
        gpu.init()


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
