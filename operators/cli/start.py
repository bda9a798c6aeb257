"""The start of a shell command: handle Ctrl-C before Blender's slow loading."""

import contextlib
import os
import signal
import sys

from ...crowd_lod.reporting import interrupt


def start() -> int:
    """Run `crowd-lod ARGV` from the shell, and return the exit code."""
    interrupt.heed()
    with interrupt.unfinished(_forget_session):
        import numpy  # noqa: F401  # Blender loads it after it has made a folder that we know of once it is loaded

        from .commands import main

        code = main()
        # all is told; a handler of ours would be taken away while Python ends
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return code


def _forget_session() -> None:
    """Remove Blender's folder of temporary files, which is empty except in a render.

    Blender removes it itself when it ends normally.
    """
    if app := getattr(sys.modules.get("_bpy"), "app", None):
        with contextlib.suppress(OSError):
            os.rmdir(app.tempdir)
