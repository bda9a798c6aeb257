"""The time that work in steps has left."""

from collections import deque

from .progress import Unsure

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
