"""The start of a shell command: Ctrl-C is handled before Blender's slow loading."""

from ...crowd_lod import interrupt


def start() -> int:
    """Run `crowd-lod ARGV` from the shell, and return the exit code."""
    try:
        with interrupt.held():
            from .commands import main
        status = main()
        interrupt.ignored()
    except KeyboardInterrupt:
        interrupt.ignored()
        status = interrupt.stopped()
    return status
