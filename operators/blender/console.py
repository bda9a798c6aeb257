"""Blender's output to stdout and stderr."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress

# What Mesa's software OpenGL says of itself at every start; it draws well all the same.
NOISE = b"EGL Error (0x3009)"


def flush() -> None:
    """Flush the streams of Python and of Blender's C library."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        # where it is full: what is to be read there is printed by streams.put
        with suppress(OSError):
            stream.flush()
    (ctypes.cdll.ucrtbase if os.name == "nt" else ctypes.CDLL(None)).fflush(None)


@contextmanager
def quiet() -> Iterator[None]:
    """Discard stdout inside the block, and write stderr at its end, except NOISE.

    Blender writes lines of progress to stdout, past Python and through it. stdout is for the
    command's own output.
    """
    flush()
    copies = [os.dup(1), os.dup(2)]
    with open(os.devnull, "w") as nowhere, tempfile.TemporaryFile() as errors:
        try:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            with redirect_stdout(nowhere):
                yield
        finally:
            flush()
            for number, copy in enumerate(copies, start=1):
                os.dup2(copy, number)
                os.close(copy)
            errors.seek(0)
            for line in errors:
                if not line.startswith(NOISE):
                    with suppress(OSError):  # a full stderr
                        os.write(2, line)
