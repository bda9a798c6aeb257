"""The first lines of a command in the shell: Ctrl-C is heeded before Blender is loaded, which takes seconds."""

import contextlib
import os
import signal
import sys

from ...crowd_lod.reporting import interrupt


def start() -> int:
    """`crowd-lod ARGV` in the shell: the exit code."""
    interrupt.heed()
    with interrupt.unfinished(_forget_session):
        import numpy  # noqa: F401  # Blender loads it after it has made a folder that we know of once it is loaded

        from .commands import main

        code = main()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is told; a handler of ours would be taken away while Python ends
        return code


def _forget_session() -> None:
    """Remove the folder of temporary files, empty but in a render, that Blender removes when it ends by itself."""
    if app := getattr(sys.modules.get("_bpy"), "app", None):
        with contextlib.suppress(OSError):
            os.rmdir(app.tempdir)
