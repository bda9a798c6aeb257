"""Standard output and error, which may be closed, full, or without the letters of a name."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast

from ..errors import CrowdError


@contextlib.contextmanager
def ready() -> Iterator[None]:
    """Inside, what stderr cannot take is lost, and what stdout has no letter for is escaped; no file that is opened gets the
    number of a stream that is closed. CrowdError if stdout is."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    with contextlib.redirect_stderr(cast(TextIO, _Lossy(sys.stderr))):
        if hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="backslashreplace")
        yield


def put(text: str) -> None:
    """Print the text, or what waits to be printed if it is "". CrowdError if stdout cannot take it; a pipe that nobody reads
    any more has seen enough."""
    if sys.stdout is None:
        raise CrowdError("Standard output is closed: send it to a file, or to /dev/null.")
    try:
        print(text, end="\n" if text else "", flush=True)
    except BrokenPipeError:
        _to_nowhere(sys.stdout)
    except OSError as error:
        _to_nowhere(sys.stdout)
        raise CrowdError(f"Standard output cannot be written ({error.strerror}): what was made stays; free space there.") from None


class _Lossy:
    """The stream, if any, as one that never fails."""

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
    """Send what follows, and what the stream still holds and would try again at exit, to no file."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
