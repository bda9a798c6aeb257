"""Copies images between bpy and NumPy."""

import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.output import file_checks
from . import removal, scene_cache
from .console import quiet

# The values last read of each image, and when.
_values = scene_cache.Bounded(8)
# seconds, while an animation plays, between two reads of an image: to read it at each frame would
# take too long
LOOK_AGAIN = 1.0


def read_values(image: bpy.types.Image) -> np.ndarray:
    """Return the image's own values, bottom row first.

    (rows, columns, channels) float32. The array is read-only, and the same array as before if the
    values are equal. While an animation plays, the values may be up to LOOK_AGAIN seconds old.
    CrowdError if the image has no pixels, or is not a single still (tiles, movie, sequence,
    render).
    """
    if image.source not in ("FILE", "GENERATED"):
        kind = {"TILED": "made of UDIM tiles", "MOVIE": "a movie", "SEQUENCE": "a sequence"}.get(
            image.source, "a render"
        )
        raise CrowdError(
            f"The image {image.name} is {kind}, not a still image: set its Source to Single "
            f"Image, or choose another image."
        )
    width, height = image.size
    if not width * height or not image.has_data and not len(image.pixels):
        path = bpy.path.abspath(image.filepath) or "no file"
        raise CrowdError(f"The image {image.name} has no pixels ({path}): load or paint it again.")
    shape = (height, width, image.channels)
    now = clock.monotonic()
    before, looked = _values.get(image.session_uid, (None, -np.inf))
    if before is not None and before.shape == shape and now < looked + LOOK_AGAIN and is_playing():
        values = before
        now = looked
    else:
        values = np.empty(shape, np.float32)
        image.pixels.foreach_get(values.ravel())
        if before is not None and np.array_equal(before, values):
            values = before
        values.flags.writeable = False
    _values[image.session_uid] = values, now
    return values


def is_playing() -> bool:
    """Return whether an animation plays in a window."""
    return any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)


def read_pixels(image: bpy.types.Image) -> np.ndarray:
    """Return the image's own values, (rows, columns, 4) uint8, bottom row first.

    CrowdError as in read_values, or if a color value is NaN or infinite.
    """
    values = read_values(image)
    check_finite(image, values[..., :3])
    height, width, channels = values.shape
    if channels < 3:
        values = values[..., :1].repeat(3, axis=2)
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., : values.shape[2]] = np.rint(values.clip(0, 1) * 255)
    return pixels


def check_finite(image: bpy.types.Image, values: np.ndarray) -> None:
    """Raise CrowdError if one of the image's values is NaN or infinite.

    values: (rows, columns, channels). Byte images cannot hold such values and are not checked.
    """
    if image.is_float and not np.isfinite(values).all():
        wrong = np.argwhere(~np.isfinite(values).all(axis=2))
        raise CrowdError(
            f"The image {image.name} holds {counted(len(wrong), 'pixel')} at NaN or infinity, the "
            f"first at column {wrong[0][1]}, row {wrong[0][0]} from the bottom: paint them again."
        )


def write_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Return a new packed image of pixels (rows, columns, 3 or 4) uint8, bottom row first."""
    rows, columns, channels = pixels.shape
    image = bpy.data.images.new(name, columns, rows, alpha=channels == 4)
    fill_image(image, pixels)
    return image


def fill_image(image: bpy.types.Image, pixels: np.ndarray) -> None:
    """Replace the pixels of an image of this size, and pack it.

    pixels: (rows, columns, 3 or 4) uint8, bottom row first.
    """
    values = np.ones((*pixels.shape[:2], 4), np.float32)
    values[..., : pixels.shape[2]] = pixels / np.float32(255)
    image.pixels.foreach_set(values.ravel())
    image.update()
    image.pack()


@contextmanager
def check_written(path: Path) -> Iterator[None]:
    """Check, after the block, that Blender wrote the file `path` completely.

    CrowdError if the file is missing or incomplete, whether or not Blender raised an error.
    """
    try:
        with quiet():
            yield
    except RuntimeError:
        file_checks.check(path)
        raise
    file_checks.check(path)


def load_pixels(path) -> np.ndarray:
    """Return the pixels of an image file.

    (rows, columns, 4) uint8, bottom row first.
    """
    image = bpy.data.images.load(str(path))
    try:
        return read_pixels(image)
    finally:
        removal.remove([image])
