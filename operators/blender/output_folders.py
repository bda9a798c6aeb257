"""Where output goes: one folder for each .blend file, beside it, with a folder for each step.

A file that was never saved has no place: its output goes to a folder of this Blender session, and
is moved beside the file when that is saved for the first time.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from .callbacks import handler

BLEND_NAME = "{blend_name}"  # in paths of settings: the .blend file's name without its ending
UNTITLED = "untitled"  # stands for it while the file was never saved


@dataclass
class _OpenFile:
    """The open file.

    number: of the file in this session; it names the temporary folder of a file without a place.
    unsaved: paths in settings whose output still lies in that folder.
    before: (owner, name, text) of the settings that differ in the file that is being saved.
    """

    number: int = 0
    unsaved: set[str] = field(default_factory=set)
    before: list[tuple[bpy.types.PropertyGroup, str, str]] = field(default_factory=list)


_file = _OpenFile()


def full_path(text: str, library: bpy.types.Library | None = None) -> Path:
    """Return the file or folder that a setting names, from the root.

    text: a path; one that begins with "//" is beside the .blend file, or, while that was never
        saved, in a folder that Blender removes when it ends.
    library: the file that holds the setting, if it is linked.

    CrowdError if the path is relative and the working folder was deleted.
    """
    if text.startswith("//") and not bpy.data.filepath and library is None:
        return _temporary(text)
    name = _insert_name(text, Path(bpy.data.filepath).stem or UNTITLED)
    return files.absolute(Path(bpy.path.abspath(name, library=library)))


def _temporary(text: str) -> Path:
    """Return where the path `text` of an unsaved file is for now."""
    parts = PurePosixPath(_insert_name(text, UNTITLED)[2:].replace("\\", "/")).parts
    return Path(
        bpy.app.tempdir,
        f"crowd_lod_{_file.number}",
        *("__" if part == ".." else part for part in parts),
    )


def output_path(scene: bpy.types.Scene, part: str) -> str:
    """Return the folder of a step's output, as a path that a setting can hold.

    full_path finds the folder by it. Where several scenes of the file have crowds and the same
    folder, each has one of its own within.

    part: the step's name.

    CrowdError if the setting is empty.
    """
    text = scene.crowd_lod.output_folder
    if not text.strip():
        raise CrowdError(
            f"Output Folder is empty: give a folder, such as //{BLEND_NAME}_crowd_lod."
        )
    neighbors = [
        other.crowd_lod for other in bpy.data.scenes if other != scene and other.library is None
    ]
    shared = any(
        other.characters is not None and other.output_folder == text for other in neighbors
    )
    names = [*[bpy.path.clean_name(scene.name)] * shared, part]
    top = text if text.endswith(("/", "\\")) else f"{text}/"
    return saved_path(top + "/".join(names))


def saved_path(text: str) -> str:
    """Return the path of existing output, to keep in a setting.

    It names the saved file that owns the output, also in one that is saved under another name
    later.
    """
    if bpy.data.filepath:
        return _insert_name(text, Path(bpy.data.filepath).stem)
    if text.startswith("//"):
        _file.unsaved.add(text)
    return text


def output_folder(scene: bpy.types.Scene, part: str) -> Path:
    """Return the folder of a step's output from the root; errors and part as output_path."""
    return full_path(output_path(scene, part))


def place_of(path: Path) -> str:
    """Return the place of output in words, with what becomes of it."""
    temporary = not bpy.data.filepath and path.is_relative_to(bpy.app.tempdir)
    fate = ", until Blender ends: save the file to keep it beside it" if temporary else ""
    return f"{printable(path)}{fate}"


def output_file(path: Path, *endings: str) -> Path:
    """Return the path of a file to be written, absolute, checked before any work is done.

    CrowdError if it ends in none of `endings`, or its folder does not exist.
    """
    path = files.absolute(with_ending(path, *endings))
    parent = os.path.dirname(os.path.realpath(path))
    if not os.path.isdir(parent):
        raise CrowdError(
            f"The file {printable(path)} cannot be written: there is no folder {printable(parent)}."
        )
    return path


def with_ending(path: Path, *endings: str) -> Path:
    """Return the path of a file; CrowdError if it ends in none of `endings`."""
    if path.suffix not in endings:
        raise CrowdError(f"The file {printable(path.name)} must end in {' or '.join(endings)}.")
    return path


def _insert_name(text: str, name: str) -> str:
    return text.replace(BLEND_NAME, name)


def _paths() -> Iterator[tuple[bpy.types.PropertyGroup, str]]:
    """Yield (owner, name) of the settings that hold paths of what was made, or is read."""
    for scene in bpy.data.scenes:
        if scene.library is None:
            yield scene.crowd_lod, "shot_plan"
            for crowd in scene.crowd_lod.crowds:
                yield crowd, "tracks_file"
                yield crowd, "simulation_file"


def is_saving() -> bool:
    """Return whether paths in settings are seen from the place of the file that is being saved."""
    return bool(_file.before)


@handler
def before_saving(path: str, *_) -> None:
    """Rewrite relative paths in settings so that they hold from the new place (save_pre)."""
    _file.before.clear()
    for owner, name in _paths() if path else ():
        text = getattr(owner, name)
        moved = _seen_from(text, Path(path)) if text.startswith("//") else text
        if moved != text:
            _file.before.append((owner, name, text))
            setattr(owner, name, moved)


def _seen_from(text: str, path: Path) -> str:
    """Return the setting's path `text` as it reads in the file `path`."""
    if not bpy.data.filepath:  # its output will move along
        return _insert_name(text, path.stem)
    if path.parent == Path(bpy.data.filepath).parent:
        return text
    with suppress(ValueError):  # another drive
        return bpy.path.relpath(str(full_path(text)), start=str(path.parent))
    return str(full_path(text))


@handler
def after_saving(path: str, *_) -> None:
    """Move the output of a file that has a place now; for a saved copy, copy it (save_post)."""
    copied = path != bpy.data.filepath
    if copied:
        after_failed_saving()
    _file.before.clear()
    for text in sorted(_file.unsaved) if path else ():
        target = Path(
            bpy.path.abspath(_insert_name(text, Path(path).stem), start=os.path.dirname(path))
        )
        _move(_temporary(text), target, copied)
        if not copied:
            _file.unsaved.remove(text)


def _move(source: Path, target: Path, copied: bool) -> None:
    """Move or copy a file or folder, also into a folder that exists."""
    if source.is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True)
        if not copied:
            shutil.rmtree(source)
    elif source.is_file():
        (shutil.copy2 if copied else shutil.move)(source, target)


@handler
def after_failed_saving(*_) -> None:
    """Take back what before_saving did to the settings of the open file (save_post_fail)."""
    for owner, name, text in _file.before:
        setattr(owner, name, text)
    _file.before.clear()


@handler
def after_opening(*_) -> None:
    """Forget the output of the file before: it is not that of the new one (load_post)."""
    _file.number += 1
    _file.unsaved.clear()
    _file.before.clear()
