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
        self.samples = samples
        self.first = frames[0]
        self.rate = rate
        length = frames[1] - frames[0]
        self.width = max(SPAN * rate, length / MOST)
        # of each span: minus the least velocity along x, y and z, the greatest, and the greatest
        # horizontal speed, squared
        self.spans = np.zeros((7, int(length / self.width) + 1))
        for begin, end, longest in classes:
            spans = np.zeros_like(self.spans)
            for at in range(begin, end, SAMPLES_AT_ONCE):
                self._add(spans, slice(at, min(at + SAMPLES_AT_ONCE, end)))
            self._join(spans, int(longest / self.width) + 1)

    def between(self, since: float, until: float) -> VelocityBounds:
        """Return the bounds of all velocities, m/s, from frame `since` to `until` of the file."""
        last = self.spans.shape[1] - 1
        begin = min(self._span(since), last)
        end = min(self._span(until), last)
        bounds = self.spans[:, begin : end + 1].max(axis=1)
        if not bounds.any():
            return STANDING
        bounds[:6] *= 1 + 1e-9  # for what rounding takes
        fastest = float(np.sqrt(bounds[6])) * (1 + 1e-9)
        return VelocityBounds(-bounds[:3], bounds[3:6], fastest)

    def _span(self, frame: float) -> int:
        """Return the number of the span that holds the frame."""
        return int((min(max(frame, self.first), self.first + 1e18) - self.first) / self.width)

    def _add(self, spans: np.ndarray, block: slice) -> None:
        """Count a block of samples, in order of frames, in the spans in which they begin."""
        samples = self.samples
        frame = samples.frame[block]
        after = samples.after[block]
        passed = (samples.frame[after] - frame) / self.rate
        passed[passed == 0] = np.inf
        places = [samples.x, samples.y] + ([] if samples.z is None else [samples.z])
        speeds = np.zeros((7, len(frame)))
        for axis, place in enumerate(places):
            speed = (place[after] - place[block]) / passed
            speeds[axis] = -speed
            speeds[3 + axis] = speed
        speeds[6] = speeds[3] ** 2 + speeds[4] ** 2
        span = np.minimum(((frame - self.first) / self.width).astype(np.intp), spans.shape[1] - 1)
        edges = np.flatnonzero(np.diff(span, prepend=-1))
        fastest = np.maximum.reduceat(speeds, edges, axis=1)
        spans[:, span[edges]] = np.maximum(spans[:, span[edges]], fastest)

    def _join(self, spans: np.ndarray, further: int) -> None:
        """Count the spans `further` than where samples begin, too: until where they may end."""
        reach = 0  # spans after their own that are counted
        while reach < further:
            shift = min(reach + 1, further - reach)
            moved = spans[:, :-shift].copy()
            np.maximum(spans[:, shift:], moved, out=spans[:, shift:])
            reach += shift
        np.maximum(self.spans, spans, out=self.spans)
