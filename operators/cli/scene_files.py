"""How commands open and save scenes, and show their progress."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path

import bpy

from ... import sample_scenes
from ...crowd_lod import interrupt
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.progress import Made, TimeLeft
from ..blender import console
from ..blender.output_folders import output_file
from ..blender.steps import leave_edit_mode

LINE = 10.0  # seconds between two lines of progress
Show = Callable[[float, str], None]  # (progress, time left in words)


def open_scene(name: str | None) -> bpy.types.Scene:
    """Open a .blend file, or make a sample scene, by `name`, and return the scene.

    None stands for the file that is open already. CrowdError if there is no such file or Blender
    cannot open it.
    """
    if name in sample_scenes.NAMES:
        # an empty file of the user's own start-up: the factory's would switch this extension off
        # while it runs
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
        scene = bpy.context.scene
        scene.name = name
        sample_scenes.make(name, scene)
    elif name is not None:
        path = Path(name)
        if not path.is_file():
            raise CrowdError(
                f"There is no file {name}, and no sample of that name: give a .blend file, or one "
                f"of {', '.join(sample_scenes.NAMES)}."
            )
        try:
            with console.quiet():
                bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
        except RuntimeError as error:
            raise CrowdError(f"Blender cannot open {name}: {first_line(error)}") from None
    scene = bpy.context.scene
    if edited := leave_edit_mode(scene):
        print(f"Edit Mode was left: {', '.join(edited)}.", file=sys.stderr)
    return scene


def first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].removeprefix("Error: ")


def stem_of(args) -> str:
    """Return the name stem of files made from the command's scene."""
    return Path(args.scene or bpy.data.filepath or "scene").stem


def blend_path(path: Path) -> Path:
    """Return the path of a .blend file, absolute, checked before any work is done.

    CrowdError if it does not end in .blend, or its folder does not exist.
    """
    return output_file(path, ".blend")


def save(part: Path, path: Path, compress: bool = False) -> None:
    """Save the open file to `part`, which is to become `path`."""
    try:
        with console.quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(part), copy=True, compress=compress)
    except RuntimeError as error:
        raise CrowdError(
            f"The file {printable(path)} cannot be written: {first_line(error)}."
        ) from None


def finish(steps: Generator[float, None, Made], title: str, quiet: bool) -> Made:
    """Run a progress generator, show the progress on stderr, and return its result.

    A terminal gets a bar; a file or a pipe a line every LINE seconds. Ctrl-C ends the steps between
    two of them.
    """
    with contextlib.ExitStack() as stack:
        check = stack.enter_context(interrupt.held())
        stack.callback(steps.close)
        show = None
        if not quiet:
            show = _bar(stack, title) if sys.stderr.isatty() else _lines(title)
        time_left = TimeLeft()
        begun = time.monotonic()
        while True:
            check()
            try:
                progress = next(steps)
            except StopIteration as end:
                return end.value
            if show is not None:
                show(progress, time_left.words(progress, time.monotonic() - begun))


def _bar(stack: contextlib.ExitStack, title: str) -> Show | None:
    """Return what draws the progress as a bar until the `stack` closes; None without tqdm."""
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    # tqdm's own lock is shared by processes, and Python would warn that it is leaked
    tqdm.set_lock(threading.RLock())
    template = "{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    bar = stack.enter_context(tqdm(total=100, desc=title, bar_format=template))

    def show(progress: float, left: str) -> None:
        bar.set_postfix_str(left.removeprefix(", "), refresh=False)
        bar.update(100 * progress - bar.n)

    return show


def _lines(title: str) -> Show:
    """Return what prints the progress as a line every LINE seconds."""
    due = time.monotonic() + LINE

    def show(progress: float, left: str) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + LINE
            print(f"{title}: {progress:.0%}{left}", file=sys.stderr, flush=True)

    return show
