"""Standard output and error, even if closed, full, or without some letters."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast

from ..errors import CrowdError


@contextlib.contextmanager
def ready() -> Iterator[None]:
    """Make the standard streams safe to use inside the block.

    Text that stderr cannot take is lost. Characters that stdout cannot encode are escaped. The file
    numbers of closed streams are taken, so that no opened file gets them.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    with contextlib.redirect_stderr(cast(TextIO, _Lossy(sys.stderr))):
        if hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="backslashreplace")
        yield


def write_out(text: str) -> None:
    """Print the text and flush; "" only flushes.

    CrowdError if stdout is closed or cannot be written. A pipe whose reader has left is no error:
    further output is dropped.
    """
    if sys.stdout is None:
        raise CrowdError("Standard output is closed: send it to a file, or to /dev/null.")
    try:
        print(text, end="\n" if text else "", flush=True)
    except BrokenPipeError:
        _to_nowhere(sys.stdout)
    except OSError as error:
        _to_nowhere(sys.stdout)
        raise CrowdError(
            f"Standard output cannot be written ({error.strerror}): finished files stay; free "
            f"space there."
        ) from None


class _Lossy:
    """A stream, or nothing for None, whose writes never fail."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream or open(os.devnull, "w")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, act: Callable[..., object], *values: str) -> None:
        try:
            act(*values)
        except OSError:
            _to_nowhere(self._stream)


def _to_nowhere(stream: TextIO) -> None:
    """Redirect the stream to no file, with text that it still buffers for its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
