"""The one way to start another process from here."""

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from . import interrupt


@contextmanager
def quiet_process(words: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Yield a new process that reads nothing and says nothing; it is killed when the block ends.

    Ctrl-C kills it too. OSError if it cannot be started.
    """
    nowhere = subprocess.DEVNULL
    with ExitStack() as stack:
        with interrupt.hold():
            process = subprocess.Popen(words, stdin=nowhere, stdout=nowhere, stderr=nowhere)
            stack.enter_context(interrupt.unfinished(partial(_end, process)))
        yield process


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        process.kill()
    process.wait()
