"""Ctrl-C ends a command with the exit code STOPPED and one line (docs/notes/files.md).

So does SIGTERM, by which a farm or a system that shuts down ends it.

Standard library only, because this module is loaded before all others.
"""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STOPPED = 128 + signal.SIGINT  # the exit code
SIGNALS = signal.SIGINT, signal.SIGTERM


def heeded() -> None:
    """Let SIGTERM do from here on what Ctrl-C does, unless it is ignored."""
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def held() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back inside the block: Blender drops a KeyboardInterrupt in its callbacks.

    Yields a function that raises KeyboardInterrupt if Ctrl-C was pressed; so does the block's end.
    A signal stays ignored if the parent process made this one ignore it.
    """
    presses: list[int] = []

    def check() -> None:
        if presses:
            raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in SIGNALS}
    taken = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    for number in taken:
        signal.signal(number, lambda number, _: presses.append(number))
    try:
        yield check
    finally:
        for number in taken:  # None: a handler of Blender's own
            signal.signal(number, before[number] or signal.default_int_handler)
    check()


def ignored() -> None:
    """Ignore Ctrl-C from here on: a command's work is done, and Blender still has to go.

    Python gives a signal back to the system before it takes modules down; Ctrl-C would end the
    process then, and Blender's temporary folder would stay.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def stopped() -> int:
    """Print the line that ends a command after Ctrl-C, and return its exit code."""
    print("crowd-lod: stopped.", file=sys.stderr)
    return STOPPED
