"""The start of a shell command: Ctrl-C is handled before Blender's slow loading."""

import sys
from importlib.metadata import version

from ...crowd_lod import interrupt
from .overview import tell


def start() -> int:
    """Run `crowd-lod ARGV` from the shell, and return the exit code."""
    if sys.argv[1:] in (["--help"], ["-h"], ["--version"]):
        tell(sys.argv[1], version("bpy"))
    interrupt.heeded()
    try:
        with interrupt.held():
            from .commands import main
        status = main()
        interrupt.ignored()
    except KeyboardInterrupt:
        interrupt.ignored()
        status = interrupt.stopped()
    return status
