"""Ctrl-C ends a command with the exit code STOPPED and one line (docs/notes/files.md).

Standard library only, because this module is loaded before all others.
"""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STOPPED = 128 + signal.SIGINT  # the exit code


@contextmanager
def held() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back inside the block: Blender drops a KeyboardInterrupt in its callbacks.

    Yields a function that raises KeyboardInterrupt if Ctrl-C was pressed; so does the block's end.
    Ctrl-C stays ignored if the parent process made this one ignore it.
    """
    presses: list[int] = []

    def check() -> None:
        if presses:
            raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        yield check
        return
    signal.signal(signal.SIGINT, lambda number, _: presses.append(number))
    try:
        yield check
    finally:
        # None: a handler of Blender's own
        signal.signal(signal.SIGINT, before or signal.default_int_handler)
    check()


def ignored() -> None:
    """Ignore Ctrl-C from here on: a command's work is done, and Blender still has to go.

    Python gives a signal back to the system before it takes modules down; Ctrl-C would end the
    process then, and Blender's temporary folder would stay.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def stopped() -> int:
    """Print the line that ends a command after Ctrl-C, and return its exit code."""
    print("crowd-lod: stopped.", file=sys.stderr)
    return STOPPED
