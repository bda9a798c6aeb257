"""Ctrl-C ends a command at once, and the disk is then as it was, or all of the output is there.

A signal's Python handler waits for the main thread to come back from C: from a render, from NumPy, from the import of Blender.
The signal itself does not: it wakes a thread, which removes what is unfinished and ends the process (docs/notes/ctrl_c.md).
Standard library only, for it is loaded before all else.
"""

import os
import signal
import socket
import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

STOPPED = 128 + signal.SIGINT  # the exit code
PATIENCE = 0.7  # seconds that a command whose output is complete has to tell so itself

line = ""  # what ends the line that the terminal's cursor is on: "\n" after a progress bar
_turn = threading.RLock()  # of the thread that puts files in place, or of the one that ends the process
_unfinished: list[Callable[[], None]] = []
_late: list[str] = []


def heed() -> None:
    """From now on Ctrl-C ends this process with STOPPED and one line, if it comes before the output is in place; after that
    the process may end by itself. Main thread only. Where whoever started the process ignores Ctrl-C, so does it."""
    if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, _ignore):
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    screen = -1
    with suppress(OSError):  # stderr may be closed: then the last line has no place to go
        screen = os.dup(2)  # what Blender prints is kept from the screen by other files in its place
    threading.Thread(target=_watch, args=(reader, writer, screen), daemon=True).start()
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _ignore)
    if hasattr(signal, "pthread_sigmask"):  # environment.py holds back what comes while Python starts
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def unfinished(clean: Callable[[], None]) -> Iterator[None]:
    """`clean` is called however the block ends, and by Ctrl-C from another thread before it ends the process."""
    _unfinished.append(clean)
    try:
        yield
    finally:
        clean()
        _unfinished.remove(clean)


@contextmanager
def work() -> Iterator[None]:
    """The work of a command: after it, also where it failed, there is nothing to be taken back."""
    _late.clear()
    try:
        yield
    finally:
        too_late("it had come to its end")


def held() -> AbstractContextManager[bool]:
    """A context inside which Ctrl-C does not end the process: it waits. Who is ended waits for it, and never comes in."""
    return _turn


def too_late(why: str) -> None:
    """From now on there is nothing to be taken back, because of `why`, a part of a sentence. Who is ended does not return."""
    with _turn:
        _late.append(why)


def _ignore(*_: object) -> None:
    """Python's own handler would raise KeyboardInterrupt wherever the main thread is, in Blender's callbacks too."""


def _watch(reader: socket.socket, writer: socket.socket, screen: int) -> None:
    while reader.recv(1) != bytes([signal.SIGINT]):
        pass
    _turn.acquire()
    if _late:
        _turn.release()
        clock.sleep(PATIENCE)
        _turn.acquire()
    try:
        with suppress(OSError):  # what the main thread says of files that are taken away under its hands
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
        _clean()
        said = f"stopped too late: {_late[0]}" if _late else "stopped; nothing on disk was changed"
        with suppress(OSError):
            os.write(screen, f"{line}crowd-lod: {said}.\n".encode())
        _clean()  # Blender, still at work, may have made folders again
    finally:
        os._exit(STOPPED)


def _clean() -> None:
    for clean in reversed(_unfinished):
        with suppress(Exception):
            clean()
