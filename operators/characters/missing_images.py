"""Characters whose textures did not come along, as with packs that keep these in a folder."""

from collections.abc import Iterator
from pathlib import Path

import bpy

from ...crowd_lod.format import printable
from ...crowd_lod.messages import Message, MessageKind
from ..blender.materials import images_of
from .rig_needs import Characters


def notes_on_images(characters: Characters) -> Iterator[Message]:
    """Yield messages on the characters' images whose files are missing."""
    for name, objects, _ in characters:
        missing = filter(_is_missing, images_of(objects))
        if paths := sorted(printable(_path_of(image)) for image in missing):
            yield Message(MessageKind.IMAGE_MISSING, name, {"paths": paths})


def _path_of(image: bpy.types.Image) -> Path:
    return Path(bpy.path.abspath(image.filepath, library=image.library))


def _is_missing(image: bpy.types.Image) -> bool:
    is_file = image.source == "FILE" and not image.packed_files
    return is_file and not image.has_data and not _path_of(image).is_file()
