"""The memory that the characters' images take in renders, and Blender's texture cache."""

from collections.abc import Iterable
from glob import escape
from pathlib import Path

import bpy

from ...crowd_lod.format import byte_size

CACHE = "blender_tx"  # the folder beside an image that has its cache, unless the user chose another
IMAGE_BYTES = "crowd_lod_image_bytes"  # custom property of the build's collection: see image_bytes


def image_bytes(images: Iterable[bpy.types.Image]) -> int:
    """Return the memory of `images` in Cycles without the texture cache.

    Bytes: width x height x 4, or x 16 for float images (Cycles may keep 8 for those that files hold
    in 16 bits).
    """
    total = 0
    for image in images:
        sizes = [tile.size for tile in image.tiles] if image.source == "TILED" else [image.size]
        total += sum(width * height for width, height in sizes) * (16 if image.is_float else 4)
    return total


def uses_cache(scene: bpy.types.Scene, image: bpy.types.Image) -> bool:
    """Return whether renders of `scene` load `image` from the texture cache.

    It then is there, or Blender makes it. Blender 4.5 has none.
    """
    render = scene.render
    is_on = render.engine == "CYCLES" and getattr(render, "use_texture_cache", False)
    if not is_on or image.packed_file or image.source not in ("FILE", "TILED"):
        return False
    path = Path(bpy.path.abspath(image.filepath, library=image.library))
    if render.use_auto_generate_texture_cache:
        return bool(image.filepath)
    folder = path.parent / (bpy.context.preferences.filepaths.texture_cache_directory or CACHE)
    name = escape(path.name).replace("<UDIM>", "*")
    return any(folder.glob(f"{name}.*.tx"))


def can_use_cache(scene: bpy.types.Scene) -> bool:
    """Return whether Cycles could render `scene` with a texture cache, and does not."""
    render = scene.render
    return (
        render.engine == "CYCLES"
        and hasattr(render, "use_texture_cache")
        and not (render.use_texture_cache and render.use_auto_generate_texture_cache)
    )


def describe_images(scene: bpy.types.Scene) -> str:
    """Return a sentence on the memory of the images in the build of `scene`; "" without images."""
    size = scene.crowd_lod.build.get(IMAGE_BYTES)
    if not size:
        return ""
    remedy = " With a texture cache Cycles loads only what pixels show of them."
    return (
        f"The characters' images take {byte_size(size)} at full size."
        f"{remedy if can_use_cache(scene) else ''}"
    )
