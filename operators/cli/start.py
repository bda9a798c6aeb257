"""The start of a shell command: Ctrl-C is handled before Blender's slow loading."""

import signal

from ...crowd_lod.reporting import interrupt
from ...crowd_lod.reporting.temporary_folder import own_temporary_folder


def start() -> int:
    """Run `crowd-lod ARGV` from the shell, and return the exit code."""
    interrupt.heed()
    with own_temporary_folder():  # Blender's session folder will lie there
        from .commands import main

        code = main()
        # all is told; a handler of ours would be taken away while Python ends
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return code
