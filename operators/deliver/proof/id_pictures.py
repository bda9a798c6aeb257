"""Pictures of who is seen: the id of the agent at each sample of the final picture."""

from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.output import file_checks
from ...blender import cameras, console, removal
from ..preview import preview_stage
from .number_materials import numbered, read_numbers
from .verify_pictures import small, views_of

MOST = 1 << 24  # samples that are rendered at a time: 16 bytes each, and Cycles' own as many
INSIDE = 0.1  # of a sample, by which a tile's border lies beside that of samples


def render_ids(
    scene: bpy.types.Scene, finer: int, folder: Path
) -> Generator[float, None, list[np.ndarray]]:
    """Render who is seen: yield between steps, return for each view (rows, columns) int32.

    The bottom row comes first; NOBODY is where no agent is.

    scene: set up for the proof, at the frame.
    finer: samples across a pixel of the final picture.
    folder: for the pictures that are rendered and read again.
    """
    width, height = (finer * length for length in cameras.image_size(scene.render))
    tall = max(1, min(height, MOST // width))
    tiles = [folder / f"ids_{low}.exr" for low in range(0, height, tall)]
    with _set_up(scene, (width, height)):
        views = views_of(scene.render)
        for number, path in enumerate(tiles):
            low = number * tall
            scene.render.border_min_y = (low + INSIDE) / height
            scene.render.border_max_y = (min(low + tall, height) + INSIDE) / height
            scene.render.filepath = str(path)
            with console.quiet(), bpy.context.temp_override(scene=scene):
                bpy.ops.render.render(write_still=True)
    yield 0.0
    ids = []
    for view in views:
        rows = []
        for path in tiles:
            rows.append(_read(path.with_stem(path.stem + view)))
            yield 0.0
        ids.append(np.concatenate(rows))
    return ids


@contextmanager
def _set_up(scene: bpy.types.Scene, size: tuple[int, int]) -> Iterator[None]:
    """Have renders of `scene` show the numbers of `size` samples, and restore it afterwards."""
    render = scene.render
    cycles = scene.cycles
    lenses = {each.data for each in scene.objects if each.type == "CAMERA"}
    owners = render, render.image_settings, *scene.view_layers, *(lens.dof for lens in lenses)
    with ExitStack() as opened:
        opened.enter_context(preview_stage.restore_settings(*owners))
        opened.enter_context(small(scene, size))
        opened.callback(setattr, scene, "world", scene.world)
        scene.world = None
        for layer in scene.view_layers:
            layer.material_override = None
            layer.use_volumes = False
        for lens in lenses:
            lens.dof.use_dof = False
        render.use_border = render.use_crop_to_border = render.film_transparent = True
        render.border_min_x, render.border_max_x = 0.0, 1.0
        render.use_motion_blur = False
        render.image_settings.file_format = "OPEN_EXR"
        render.image_settings.color_depth = "32"
        cycles.samples = 1
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 0.01  # pixels: each sample in the middle of its pixel
        cycles.max_bounces = 0
        cycles.sample_clamp_direct = 0
        cycles.film_exposure = 1
        opened.enter_context(numbered(scene))
        yield


def _read(path: Path) -> np.ndarray:
    """Return whom a rendered picture shows, (rows, columns) int32, and remove its file."""
    file_checks.check(path)
    image = bpy.data.images.load(str(path))
    try:
        width, height = image.size
        values = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(values)
    finally:
        removal.remove([image])
    path.unlink()
    return read_numbers(values.reshape(height, width, -1))
