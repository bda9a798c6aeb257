"""Work in steps: generators that yield their progress, from 0 to 1, between the steps, and return what they made."""

import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from contextlib import closing
from typing import Any, TypeVar

LOOK = 0.05  # seconds between two looks at work that another thread does
_own = threading.local()
Made = TypeVar("Made")  # what the work returns


class Ended(BaseException):
    """Nobody waits any longer for the work that this thread does."""


def finished(steps: Generator[Any, None, Made]) -> Made:
    """What the generator returns, all its steps done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def share(steps: Generator[float, None, Made], begin: float, end: float) -> Generator[float, None, Made]:
    """The generator's progress as the part from `begin` to `end` of the whole; returns what it returns. Closed early, it closes the
    generator at once: before its caller tidies up, and not when Python frees it."""
    return (yield from _told(steps, lambda progress: begin + (end - begin) * progress))


def standing(steps: Generator[Any, None, Made], progress: float) -> Generator[float, None, Made]:
    """Yields `progress` at each of the generator's steps, whatever it yields; returns what it returns. Closed early, as share."""
    return (yield from _told(steps, lambda _: progress))


def _told(steps: Generator[Any, None, Made], tell: Callable[[Any], float]) -> Generator[float, None, Made]:
    with closing(steps):
        while True:
            try:
                progress = next(steps)
            except StopIteration as stop:
                return stop.value
            yield tell(progress)


def aside(work: Callable[[], Made], progress: Callable[[], float] = lambda: 0.0) -> Generator[float, None, Made]:
    """Do `work`, of NumPy alone, in another thread: for long work that is no generator. Yields what `progress` says while it
    lasts, and returns what it returns. Closed early, the work ends at its next `breath`."""
    task: Future[Made] = Future()
    ended = threading.Event()

    def run() -> None:
        _own.ended = ended
        try:
            task.set_result(work())
        except BaseException as error:  # it belongs to who waits
            task.set_exception(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        while not wait([task], LOOK).done:
            yield progress()
        return task.result()
    finally:
        ended.set()
        thread.join()


def breath() -> None:
    """A place where work may be ended that `aside` does."""
    ended = getattr(_own, "ended", None)
    if ended is not None and ended.is_set():
        raise Ended
