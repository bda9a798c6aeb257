"""Characters whose textures did not come along, as with packs that keep these in a folder."""

from collections.abc import Iterator
from pathlib import Path

import bpy

from ...crowd_lod.format import counted, printable
from ..blender.materials import images_in
from .rig_needs import Characters


def notes_on_images(characters: Characters) -> Iterator[str]:
    """Yield a sentence on the characters' images whose files are missing."""
    wearers: dict[bpy.types.Image, list[str]] = {}
    for name, objects, _ in characters:
        materials = {slot.material for item in objects for slot in item.material_slots}
        for image in set().union(*map(images_in, materials - {None})):
            if _is_missing(image):
                wearers.setdefault(image, []).append(name)
    if not wearers:
        return
    image = min(wearers, key=lambda missing: missing.name)
    names = ", ".join(dict.fromkeys(name for group in wearers.values() for name in group))
    count = len(wearers)
    yield (
        f"{counted(count, 'image')} of {names} {'is' if count == 1 else 'are'} missing, and "
        f"{'renders' if count == 1 else 'render'} pink ({printable(_path_of(image))}): copy the "
        f"pack's textures there, or use File > External Data > Find Missing Files."
    )


def _path_of(image: bpy.types.Image) -> Path:
    return Path(bpy.path.abspath(image.filepath, library=image.library))


def _is_missing(image: bpy.types.Image) -> bool:
    is_file = image.source == "FILE" and not image.packed_files
    return is_file and not image.has_data and not _path_of(image).is_file()
