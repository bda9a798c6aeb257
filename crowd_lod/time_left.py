"""The time that work in steps has left."""

from collections import deque

EARLY = 0.25  # progress from which on it is said
KNOWN = 1.4  # times that estimates of the whole differ, at most, where it is said


class TimeLeft:
    """The time that a step has left, as its progress tells.

    It is said once a part is done, and where the latter half of the time has told about the same
    whole: some searches take more tries than others, and call for further ones.
    """

    def __init__(self) -> None:
        self._wholes: deque[tuple[float, float]] = deque()  # (at which second, estimated seconds)

    def words(self, progress: float, seconds: float) -> str:
        """Return a text with the time left, or "" in the first two seconds.

        progress: 0 to 1, reached in `seconds`; "" at 0 too.
        """
        if seconds < 2 or not progress > 0:
            return ""
        self._wholes.append((seconds, seconds / progress))
        while self._wholes[0][0] < seconds / 2:
            self._wholes.popleft()
        wholes = [whole for _, whole in self._wholes]
        if progress >= EARLY and max(wholes) <= KNOWN * min(wholes):
            return f", about {_duration(wholes[-1] - seconds)} left"
        return ""


def _duration(seconds: float) -> str:
    """Return the seconds in words such as "3 min"."""
    unit, words = next(
        (unit, words)
        for unit, words in ((3600, "h"), (60, "min"), (1, "s"))
        if seconds >= 1.5 * unit or unit == 1
    )
    return f"{seconds / unit:,.0f} {words}"
