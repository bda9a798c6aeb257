"""Work in steps: generators that yield their progress, from 0 to 1, and the time that is left.

Between two yields they do a step of the work. They return the result.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from itertools import count
from typing import Any, TypeVar

MOST_THREADS = 4  # of work in NumPy
TICK = 0.04  # seconds of work between two pauses
LOOK = 0.02  # seconds between two looks at work that another thread does
_own = threading.local()
Made = TypeVar("Made")  # what the work returns


def count_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Cancelled(BaseException):
    """Raised in a worker thread when nobody waits for its result any longer."""


def finished(steps: Generator[Any, None, Made]) -> Made:
    """Run all steps of the generator at once and return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


class Pauses:
    """When work yields that has something to put back before it does: every TICK seconds.

    What it takes to go on does not count: the time begins with the first question after a pause.
    """

    def __init__(self) -> None:
        self._until: float | None = None

    def is_due(self) -> bool:
        """Return whether to yield now."""
        now = time.monotonic()
        if self._until is None:
            self._until = now + TICK
            return False
        if now < self._until:
            return False
        self._until = None
        return True

    def after(self, progress: float, put_back: Callable[[], object]) -> Iterator[float]:
        """Yield the progress if a pause is due, once what the work has changed is put back."""
        if self.is_due():
            put_back()
            yield progress


class Workload:
    """Work in parts: what it costs is announced, then the parts are done, and the progress follows.

    Costs are as the parts' times, in any unit. One that is announced later may set the progress
    back, so that the time left stays true.
    """

    def __init__(self, cost: float = 0.0) -> None:
        self.done = 0.0
        self.left = cost

    def announce(self, cost: float) -> None:
        """Say what all that is left costs."""
        self.left = cost

    def take(
        self, steps: Generator[Any, None, Made], cost: float = 0.0
    ) -> Generator[float, None, Made]:
        """Take the steps of a part: yield the progress of the whole, and return the part's result.

        What the steps of a part without cost yield is ignored: the progress stands. If this
        generator is closed early, it closes the steps at once: before the caller cleans up, not
        when Python frees them.
        """
        begin = self._progress(0.0)
        more = self._progress(cost) - begin

        def whole(part: Any) -> float:
            progress = begin + more * part if more else begin
            return Unsure(progress) if isinstance(part, Unsure) else progress

        result = yield from _told(steps, whole)
        self.did(cost)
        return result

    def did(self, cost: float) -> float:
        """Count a part of that cost as done, and return the progress."""
        self.done += cost
        self.left = max(self.left - cost, 0.0)
        return self._progress(0.0)

    def _progress(self, more: float) -> float:
        """Return the progress when `more` than what is done now will be done."""
        done = self.done + more
        whole = max(self.done + self.left, done)
        return done / whole if whole else 0.0


class Unsure(float):
    """A progress that tells nothing of the time left."""


def unsure(steps: Generator[float, None, Made]) -> Generator[float, None, Made]:
    """Yield the generator's progress as Unsure, and return its result.

    It is for parts before others that take another time beside them on each machine, such as making
    LODs before renders.
    """
    return (yield from _told(steps, Unsure))


def open_ended_progress(
    steps: Generator[Any, None, Made], usual: int
) -> Generator[float, None, Made]:
    """Yield the progress of a search that may take any number of steps, and return its result.

    It is a half after `usual` steps, and then a half of the rest after as many more.
    """
    taken = count(1)
    return (yield from _told(steps, lambda _: 1 - 0.5 ** (next(taken) / usual)))


def _told(
    steps: Generator[Any, None, Made], tell: Callable[[Any], float]
) -> Generator[float, None, Made]:
    with closing(steps):
        while True:
            try:
                progress = next(steps)
            except StopIteration as stop:
                return stop.value
            yield tell(progress)


def run_in_thread(
    work: Callable[[], Made], progress: Callable[[], float] = lambda: 0.0
) -> Generator[float, None, Made]:
    """Run `work` in another thread, yield its progress, and return its result.

    It is for long work in NumPy alone that is no generator.
    progress: called for each value to yield, every LOOK seconds.
    If the generator is closed early, the work ends at its next `check_cancelled`.
    """
    task: Future[Made] = Future()
    ended = threading.Event()

    def run() -> None:
        _own.ended = ended
        try:
            task.set_result(work())
        except BaseException as error:  # it belongs to who waits
            task.set_exception(error)

    thread = threading.Thread(target=run, daemon=True)
    with starting_threads():
        thread.start()
    try:
        while not wait([task], LOOK).done:
            yield progress()
        return task.result()
    finally:
        ended.set()
        thread.join()


@contextmanager
def starting_threads() -> Iterator[None]:
    """Raise MemoryError where Python lacks the memory to start a thread inside."""
    try:
        yield
    except RuntimeError as error:
        if "start new thread" in str(error):
            raise MemoryError(str(error)) from error
        raise


def run_steps_in_thread(steps: Generator[float, None, Made]) -> Generator[float, None, Made]:
    """Run the generator in another thread, yield its progress, and return its result.

    It is for steps in NumPy alone. If this one is closed early, the steps end at the next of them.
    """
    progress = [0.0]

    def work() -> Made:
        return finished(_told(steps, note))

    def note(value: float) -> float:
        check_cancelled()
        progress[0] = value
        return value

    return (yield from run_in_thread(work, lambda: progress[0]))


def check_cancelled() -> None:
    """Raise Cancelled if this thread runs work of `run_in_thread` that nobody waits for.

    Work calls it at each place where it may be ended.
    """
    ended = getattr(_own, "ended", None)
    if ended is not None and ended.is_set():
        raise Cancelled


def map_in_threads(work: Callable[..., Made], items: Iterable[tuple]) -> Iterator[Made]:
    """Yield the results of `work` on each of `items`, its arguments, in their order.

    As many threads as cores, MOST_THREADS at most, do some at a time, so it is for work in NumPy,
    which lets threads run beside each other. Errors are raised in the order of the items. If the
    generator is closed early, what is not begun is left out.
    """
    threads = min(count_cores(), MOST_THREADS)
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[Future[Made]] = deque()
        try:
            for item in items:
                with starting_threads():
                    ahead.append(pool.submit(work, *item))
                if len(ahead) > threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for task in ahead:
                task.cancel()


EARLY = 0.25  # progress from which on it is said
KNOWN = 1.4  # times that estimates of the whole differ, at most, where it is said
LEAST = 0.1  # of the progress that must have been seen, and seconds
SECONDS = 2.0


class TimeLeft:
    """The time that a step has left, as its progress tells that is not Unsure.

    It is said where the latter half of the time has told about the same whole: some searches take
    more tries than others, and call for further ones.
    """

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None  # (second, progress) from which on it counts
        self._wholes: deque[tuple[float, float]] = deque()  # (at which second, estimated seconds)

    def words(self, progress: float, seconds: float) -> str:
        """Return a text with the time left, or "" where it is not known.

        progress: 0 to 1, reached in `seconds`.
        """
        if isinstance(progress, Unsure):
            self._begin = None
            return ""
        if self._begin is None or progress < self._begin[1]:
            self._begin = seconds, progress
            self._wholes.clear()
        taken = seconds - self._begin[0]
        done = progress - self._begin[1]
        if taken < SECONDS or done < LEAST:
            return ""
        self._wholes.append((taken, taken / done * (1 - self._begin[1])))
        while self._wholes[0][0] < taken / 2:
            self._wholes.popleft()
        wholes = [whole for _, whole in self._wholes]
        if progress < EARLY or max(wholes) > KNOWN * min(wholes):
            return ""
        return f", about {_duration(max(wholes[-1] - taken, 0.0))} left"


def _duration(seconds: float) -> str:
    """Return the seconds in words such as "3 min"."""
    unit, words = next(
        (unit, words)
        for unit, words in ((3600, "h"), (60, "min"), (1, "s"))
        if seconds >= 1.5 * unit or unit == 1
    )
    return f"{seconds / unit:,.0f} {words}"
