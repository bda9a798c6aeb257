"""How fast the agents of tracks move at most, by the time."""

import numpy as np

from ..crowd.velocity_bounds import STANDING, VelocityBounds
from .samples import TrackSamples

SPAN = 0.5  # seconds, of which one bound is kept
MOST = 20_000  # such spans
SAMPLES_AT_ONCE = 2**20  # samples looked at together


class StepBounds:
    """The bounds of all velocities in each span of time.

    So a slip of a tracker slows the plan of its own second, not that of the whole shot.

    samples, classes, rate: as in Tracks.
    frames: the first and the last of the file.
    """

    def __init__(
        self,
        samples: TrackSamples,
        classes: tuple[tuple[int, int, float], ...],
        frames: tuple[float, float],
        rate: float,
    ):
        self.samples, self.first, self.rate = samples, frames[0], rate
        whole = frames[1] - frames[0]
        self.width = max(SPAN * rate, whole / MOST)
        # least x, y, z; the greatest; the greatest horizontal speed, squared; each as large as can
        # be
        self.spans = np.zeros((7, int(whole / self.width) + 1))
        for begin, end, longest in classes:
            own = np.zeros_like(self.spans)
            for at in range(begin, end, SAMPLES_AT_ONCE):
                self._add(own, slice(at, min(at + SAMPLES_AT_ONCE, end)))
            self._join(own, int(longest / self.width) + 1)

    def between(self, since: float, until: float) -> VelocityBounds:
        """Return the bounds of all velocities, m/s, from frame `since` to `until` of the file."""
        last = self.spans.shape[1] - 1
        begin, end = (
            (min(max(frame, self.first), self.first + 1e18) - self.first) / self.width
            for frame in (since, until)
        )
        own = self.spans[:, min(int(begin), last) : min(int(end), last) + 1].max(axis=1)
        if not own.any():
            return STANDING
        more = 1 + 1e-9  # for what rounding takes
        return VelocityBounds(-own[:3] * more, own[3:6] * more, float(np.sqrt(own[6])) * more)

    def _add(self, spans: np.ndarray, some: slice) -> None:
        """Count the samples `some`, which are in order of frames, in the spans in which they
        begin.
        """
        samples = self.samples
        frame, after = samples.frame[some], samples.after[some]
        passed = (samples.frame[after] - frame) / self.rate
        passed[passed == 0] = np.inf
        places = [samples.x, samples.y] + ([] if samples.z is None else [samples.z])
        speeds = np.zeros((7, len(frame)))
        for axis, place in enumerate(places):
            speed = (place[after] - place[some]) / passed
            speeds[axis], speeds[3 + axis] = -speed, speed
        speeds[6] = speeds[3] ** 2 + speeds[4] ** 2
        span = np.minimum(((frame - self.first) / self.width).astype(np.intp), spans.shape[1] - 1)
        edges = np.flatnonzero(np.diff(span, prepend=-1))
        found = np.maximum.reduceat(speeds, edges, axis=1)
        spans[:, span[edges]] = np.maximum(spans[:, span[edges]], found)

    def _join(self, spans: np.ndarray, further: int) -> None:
        """Count the spans `further` than where samples begin, too: until where they may end."""
        reach = 0  # spans after their own that are counted
        while reach < further:
            shift = min(reach + 1, further - reach)
            moved = spans[:, :-shift].copy()
            np.maximum(spans[:, shift:], moved, out=spans[:, shift:])
            reach += shift
        np.maximum(self.spans, spans, out=self.spans)
