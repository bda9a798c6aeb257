"""The playblast: the scene's solid picture and the overlay over it, as a viewport shows them, drawn without a window."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod.behaviour.trajectory import Trajectory
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.planning.frame import Frame
from ..blender import console, image_data
from ..blender.color_space import linear
from ..crowd.scene_crowd import policy_of
from . import character_cache, hud
from .appearance import cast_of, colours_of, drawing_of, style_of
from .gpu_draw import Batches, paint, put_depth

# What a viewport is lent for a picture, from the scene's own shading of its Workbench renders.
SHADING = (
    "light color_type show_shadows show_cavity show_object_outline show_xray show_specular_highlight show_backface_culling"
).split()
GAMMA = 2.2  # of the picture, where Blender's viewports lay overlays over it


class Canvas:
    """Pictures of `size`, (width, height) pixels, drawn on the GPU. To be freed."""

    def __init__(self, size: tuple[int, int]):
        from gpu.types import GPUFrameBuffer, GPUOffScreen, GPUTexture

        self.size, self._solid = size, GPUOffScreen(*size)
        # as a viewport has them for its overlays; a framebuffer does not keep its textures
        self._textures = GPUTexture(size, format="SRGB8_A8"), GPUTexture(size, format="DEPTH_COMPONENT32F")
        self._overlay = GPUFrameBuffer(color_slots=self._textures[0], depth_slot=self._textures[1])

    def free(self) -> None:
        self._solid.free()
        self._overlay = self._textures = None

    def picture(  # noqa: PLR0913 - to be cut with the overlay
        self, scene, layer, viewport: tuple, view: np.ndarray, projection: np.ndarray, batches: Batches | None, caption: str = ""
    ) -> np.ndarray:
        """(height, width, 4) uint8, sRGB, bottom row first: the scene's view layer as the viewport, (space, region), shows it;
        over it the batches, hidden by what stands before them, and the caption.

        view, projection: see drawing.paint.
        """
        import gpu
        from mathutils import Matrix

        width, height = self.size
        matrices = Matrix(view.tolist()), Matrix(projection.tolist())
        self._solid.draw_view3d(scene, layer, *viewport, *matrices, do_color_management=True)
        with self._solid.bind():
            buffer = gpu.state.active_framebuffer_get()
            picture, depth = self._read(buffer), buffer.read_depth(0, 0, width, height)
        with self._overlay.bind():
            self._overlay.clear(color=(0, 0, 0, 0), depth=1.0)
            if batches is not None:
                put_depth(depth, self.size)
                paint(batches, view, projection, self.size, bpy.context.preferences.system.ui_scale)
            if caption:
                self._write(caption)
            over = self._read(self._overlay)
        covered = over[..., 3] > 0
        picture[covered] = _merged(picture[covered], over[covered])
        return picture

    def _read(self, buffer) -> np.ndarray:
        """The framebuffer's colours, (height, width, 4) uint8."""
        width, height = self.size
        return np.array(memoryview(buffer.read_color(0, 0, width, height, 4, 0, "UBYTE"))).reshape(height, width, 4)

    def _write(self, caption: str) -> None:
        import gpu
        from mathutils import Matrix

        width, height = self.size
        to_clip = Matrix.Translation((-1, -1, 0)) @ Matrix.Diagonal((2 / width, 2 / height, 1, 1))
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_matrix(Matrix())
            gpu.matrix.load_projection_matrix(to_clip)
            hud.write([hud.Line(caption)], (0, 0, width, height), max(0.75, width / 960))


def _merged(below: np.ndarray, over: np.ndarray) -> np.ndarray:
    """The colours (n, 4) uint8, sRGB, `over` with its alpha multiplied in, laid over `below` as Blender's viewports do it,
    with linear light for the overlay and GAMMA for all else (gpu_shader_display_transform)."""
    over = over / np.float32(255)
    light = (below / np.float32(255)) ** GAMMA * (1 - over[:, 3:]) + linear(over)
    return np.rint(255 * light.clip(0, 1) ** (1 / GAMMA)).astype(np.uint8)


@contextmanager
def solid_viewport(scene: bpy.types.Scene) -> Iterator[tuple]:
    """(space, region) of a viewport that shows the whole scene in solid shading, as its Workbench renders are shaded, on the
    world's colour; afterwards it is as it was."""
    areas = (area for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D")
    whole = (area for area in areas if area.spaces[0].local_view is None and not area.spaces[0].use_local_collections)
    area = next((area for area in whole if not area.spaces[0].region_3d.use_clip_planes), None)
    if area is None:
        raise CrowdError(
            "The overlay's preview draws with a 3D viewport, and there is none that shows the whole scene: open one "
            "without local view, local collections and clipping region, or choose another engine."
        )
    space, own = area.spaces[0], scene.display.shading
    lent = {name: getattr(own, name) for name in SHADING} | {"type": "SOLID", "background_type": "WORLD", "use_dof": False}
    before, overlays = {name: getattr(space.shading, name) for name in lent}, space.overlay.show_overlays
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
    """Pictures of a stage of the preview, `size` pixels large, drawn with the overlay. As a context: it lets go of all it
    holds."""

    def __init__(self, stage: bpy.types.Scene, trajectory: Trajectory, size: tuple[int, int]):
        self.stage, self.trajectory, self.size = stage, trajectory, size
        self.cast = self.batches = None
        self.notes: tuple[str, ...] = ()

    def __enter__(self):
        self.canvas = Canvas(self.size)
        return self

    def __exit__(self, *_):
        self.canvas.free()
        self.cast = self.batches = None
        character_cache.drop(self.stage)

    def prepare(self) -> Iterator[float]:
        """Read the characters; yields the progress, 0 to 1."""
        yield from character_cache.read(self.stage)
        self.style, self.characters, self.notes = style_of(self.stage, policy_of(self.stage.crowd_lod).count)
        if self.style.mode != self.stage.crowd_lod.overlay_mode:
            raise CrowdError(" ".join(self.notes))
        self.cast = cast_of(self.trajectory.groups, self.style, self.characters)

    def place(self, frame: Frame) -> None:
        """Hand the frame's agents to the GPU."""
        settings = self.stage.crowd_lod
        coloured = colours_of(settings.overlay_color, frame, self.characters)
        # the frustum that is looked along is the picture's edge
        what = drawing_of(settings, frame, self.style, coloured, framed=False)
        self.batches = Batches(what, self.cast)

    def main(self, path: Path, caption: str) -> None:
        """Write what the stage's camera sees, the agents included."""
        self._draw(path, caption, self.batches)

    def above(self, path: Path, caption: str) -> None:
        """Write what the stage's camera sees."""
        self._draw(path, caption, None)

    def _draw(self, path: Path, caption: str, batches: Batches | None) -> None:
        stage, layer = self.stage, self.stage.view_layers[0]
        layer.depsgraph.update()
        matrices = camera_matrices(stage.camera, layer.depsgraph, stage.render, self.canvas.size)
        with solid_viewport(stage) as viewport:
            caption = f"Frame {stage.frame_current}  {caption}"
            image_data.save_png(path, self.canvas.picture(stage, layer, viewport, *matrices, batches, caption))


def camera_matrices(
    camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph, render: bpy.types.RenderSettings, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """(view, projection), as drawing.paint takes them, of the camera's picture of `size` pixels."""
    view = np.linalg.inv(np.array(camera.evaluated_get(depsgraph).matrix_world, np.float64))
    (x, y), (scale_x, scale_y) = size, (render.pixel_aspect_x, render.pixel_aspect_y)
    return view, np.array(camera.calc_matrix_camera(depsgraph, x=x, y=y, scale_x=scale_x, scale_y=scale_y), np.float64)


def need_gpu() -> None:
    """Start the GPU where there is no window. CrowdError if there is none.

    Without a driver Blender does not raise but ends, so another process tries first.
    """
    if not bpy.app.background:
        return
    import gpu

    if bpy.app.version < (5, 1, 0):
        raise CrowdError(
            f"Blender {bpy.app.version_string} has no GPU without a window: take Blender 5.1 or later for the engine overlay, "
            "or another engine."
        )
    code = "import bpy, gpu; gpu.init()"
    blender = [bpy.app.binary_path, "--background", "--factory-startup", "--python-expr"]
    command = [*(blender if bpy.app.binary_path else [sys.executable, "-c"]), code]
    if subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
        raise CrowdError(
            "The engine overlay needs OpenGL or Vulkan, and no driver of them starts here: install one (Mesa's draws without "
            "a graphics card), or choose another engine."
        )
    with console.quiet():
        gpu.init()
