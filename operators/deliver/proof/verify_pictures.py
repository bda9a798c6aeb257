"""The whole pictures of a proof: rendered small, compared, and written as PNG."""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.culling.camera import EYES
from ....crowd_lod.output import file_checks
from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.progress import run_in_thread
from ...blender import cameras, console, image_data, removal
from ..preview import preview_stage

PICTURES = {
    "a": "everyone, full detail",
    "b": "culled, full detail",
    "c": "as built",
}
TITLES = (  # of the contact sheet's columns: PICTURES, then how "b" and "c" differ from "a"
    "Everyone, full detail",
    "Culled, full detail",
    "As built",
    "Difference: culled",
    "Difference: as built",
)
# in the pictures of differences, of 255: times, and at least
AMPLIFIED = 16
FAINTEST = 60


@contextmanager
def small(scene: bpy.types.Scene, size: tuple[int, int]) -> Iterator[None]:
    """Set the size of renders, (width, height) pixels, and restore it afterwards.

    The pictures show no more than those of the scene's own size, for which agents are culled: the
    same window, and a pixel filter that reaches as far.
    """
    render = scene.render
    width, height = size
    own_width, own_height = cameras.image_size(render)
    with preview_stage.restore_settings(render, scene.cycles):
        scene.cycles.filter_width *= min(width / own_width, 1.0)
        render.resolution_x = width
        render.resolution_y = height
        render.resolution_percentage = 100
        taller = width * own_height / (own_width * height)  # the pixels, than the scene's own
        render.pixel_aspect_x *= max(1 / taller, 1.0)
        render.pixel_aspect_y *= max(taller, 1.0)
        yield


def render_picture(
    stage: bpy.types.Scene, path: Path, is_kept: bool
) -> Generator[float, None, np.ndarray]:
    """Render a picture: yield between steps, return its linear values.

    They are (rows, columns, 4) float32, bottom row first. The views of a stereo picture stand side
    by side.

    path: of its PNG, which `is_kept`, or not made.
    """
    settings = stage.render.image_settings
    with console.quiet(), bpy.context.temp_override(scene=stage):
        settings.file_format = "OPEN_EXR"
        settings.color_depth = "32"
        stage.render.filepath = str(path.with_suffix(".exr"))
        bpy.ops.render.render(write_still=True)
    settings.file_format = "PNG"
    settings.color_depth = "8"
    yield 0.0
    values = []
    pixels = []
    for view in views_of(stage.render):
        raw = path.with_name(f"{path.stem}{view}.exr")
        file_checks.check(raw)
        image = bpy.data.images.load(str(raw))
        try:
            values.append(image_data.read_values(image))
            if is_kept:
                pixels.append(_developed(stage, image, raw.with_suffix(".png")))
        finally:
            removal.remove([image])
        raw.unlink()
        yield 0.0
    if is_kept:
        yield from run_in_thread(partial(save_png, path, np.concatenate(pixels, axis=1)))
    return np.concatenate(values, axis=1)


def _developed(stage: bpy.types.Scene, image: bpy.types.Image, path: Path) -> np.ndarray:
    """Return a rendered image as `stage` shows it, (rows, columns, 4) uint8; `path` is free."""
    with image_data.check_written(path):
        image.save_render(str(path), scene=stage)
    pixels = image_data.load_pixels(path)
    path.unlink()
    return pixels


def views_of(render: bpy.types.RenderSettings) -> list[str]:
    """Return the file suffixes of the picture's views, such as the eyes of stereo."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == "STEREO_3D"
    return [
        view.file_suffix for view in render.views if view.use and (view.name in EYES or not stereo)
    ]


def amplified(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the amplified difference of two pictures, (rows, columns, 4) uint8.

    Black is no difference. Any other is at least FAINTEST.
    """
    off = np.abs(a - b)
    picture = np.rint(255 * (AMPLIFIED * off).clip(0, 1)).astype(np.uint8)
    picture[off > 0] = np.maximum(picture[off > 0], FAINTEST)
    picture[..., 3] = 255
    return picture
