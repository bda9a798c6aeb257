"""The folders that settings name for output, and files in them."""

import os
from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.reporting import files


def output_folder(text: str) -> Path:
    """Return the folder that a setting names, from the root.

    text: a path; one that begins with "//" is beside the .blend file. While that has no place yet,
        it is in a folder of this Blender session, which Blender removes when it ends.

    CrowdError if the path is relative and the working folder was deleted.
    """
    if _unsaved(text):
        return Path(bpy.app.tempdir, bpy.path.clean_name(text[2:]))
    return files.absolute(Path(bpy.path.abspath(text)))


def place_of(text: str) -> str:
    """Return the `output_folder` in words, with what becomes of it."""
    until = ", until Blender ends: save the file to keep later ones beside it" if _unsaved(text) else ""
    return f"{printable(output_folder(text))}{until}"


def _unsaved(text: str) -> bool:
    return text.startswith("//") and not bpy.data.filepath


def output_file(path: Path, *endings: str) -> Path:
    """Return the path of a file to be written, absolute, checked before any work is done.

    CrowdError if it ends in none of `endings`, or its folder does not exist.
    """
    if path.suffix not in endings:
        raise CrowdError(f"The file {printable(path.name)} must end in {' or '.join(endings)}.")
    path = files.absolute(path)
    parent = os.path.dirname(os.path.realpath(path))
    if not os.path.isdir(parent):
        raise CrowdError(f"The file {printable(path)} cannot be written: there is no folder {printable(parent)}.")
    return path
