"""Ctrl-C ends a command at once, with no output in place or all of it.

Python runs a signal's handler only when the main thread returns from C: from a render, from NumPy,
from the import of Blender. The signal itself wakes a thread at once. That thread removes unfinished
files and ends the process (docs/notes/files.md).
Standard library only, because this module is loaded before all others.
"""

import os
import signal
import socket
import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

STOPPED = 128 + signal.SIGINT  # the exit code
PATIENCE = 0.7  # seconds in which a command whose output is complete may end by itself

left = "nothing on disk was changed"  # after Ctrl-C, as part of a sentence
line = ""  # what ends the line that the terminal's cursor is on: "\n" after a progress bar
# held while files are put in place, or for ever once the process is being ended
_turn = threading.RLock()
_unfinished: list[Callable[[], None]] = []
_late: list[str] = []


def heed() -> None:
    """Let Ctrl-C end this process with the exit code STOPPED and one line.

    If the output is already in place, the process first gets PATIENCE seconds to end by itself.
    Call it from the main thread. Does nothing if the parent process made this one ignore Ctrl-C.
    """
    if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, _ignore):
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    screen = -1
    with suppress(OSError):  # stderr may be closed: then the last line has no place to go
        # a copy, since stderr itself is redirected while Blender's own prints are kept off screen
        screen = os.dup(2)
    threading.Thread(target=_watch, args=(reader, writer, screen), daemon=True).start()
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _ignore)


@contextmanager
def unfinished(clean: Callable[[], None]) -> Iterator[None]:
    """Call `clean` when the block ends, after an error too.

    After Ctrl-C the thread that ends the process calls it.
    """
    _unfinished.append(clean)
    try:
        yield
    finally:
        clean()
        _unfinished.remove(clean)


@contextmanager
def work() -> Iterator[None]:
    """Mark the work of a command: once it has ended or failed, nothing can be undone."""
    _late.clear()
    try:
        yield
    finally:
        too_late("the command had already finished")


def hold() -> AbstractContextManager[bool]:
    """Return a context inside which Ctrl-C waits and does not end the process.

    If Ctrl-C is already ending the process, entering the context never returns.
    """
    return _turn


def too_late(why: str) -> None:
    """Declare that from now on nothing can be undone.

    If Ctrl-C is already ending the process, the call never returns.
    why: the reason, a part of a sentence.
    """
    with _turn:
        _late.append(why)


def _ignore(*_: object) -> None:
    """Do nothing.

    Python's own handler would raise KeyboardInterrupt wherever the main thread is, even in a
    callback of Blender.
    """


def _watch(reader: socket.socket, writer: socket.socket, screen: int) -> None:
    while reader.recv(1) != bytes([signal.SIGINT]):
        pass
    _turn.acquire()
    if _late:
        _turn.release()
        clock.sleep(PATIENCE)
        _turn.acquire()
    try:
        # what the main thread says of files that are taken away under its hands
        with suppress(OSError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
        for clean in reversed(_unfinished):
            with suppress(Exception):
                clean()
        said = f"stopped too late: {_late[0]}" if _late else f"stopped; {left}"
        with suppress(OSError):
            os.write(screen, f"{line}crowd-lod: {said}.\n".encode())
    finally:
        os._exit(STOPPED)
