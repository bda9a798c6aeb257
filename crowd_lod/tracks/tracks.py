"""Tracks: where a file has its agents at any time, and how they move.

Every row of the file begins an interval, which ends at the agent's next row. Intervals are kept in
classes of like length, those of a class by when they begin. So those that hold at a time lie
together, whoever is there, and a crowd that enters and leaves costs no more than who is present.

Rows are in the order of agents, and of each agent in the order of frames. A run is a stretch of an
agent's rows, without a gap that hides it.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..crowd import random_streams
from ..crowd.bounds import STANDING, VelocityBounds


@dataclass(frozen=True, eq=False)
class TrackSamples:
    """The rows of a file, each with what holds until the agent's next row, in the order of Tracks.

    agent: (k,) int32.
    frame: (k,) float64, of the file.
    x, y, z: (k,) float64 meters; z None if the file has none.
    heading, turn: (k,) float32 radians, and its change until the next row.
    way: (k,) float32 meters walked since the agent entered, or cycles if the file gives phases.
    pace: (k,) uint8.
    walks, hidden: (k,) bool, whether the agent walks, and whether a long gap hides it.
    after: (k,) int32, the place of the agent's next row; its own at the agent's last.
    """

    agent: np.ndarray
    frame: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray | None
    heading: np.ndarray
    turn: np.ndarray
    way: np.ndarray
    pace: np.ndarray
    walks: np.ndarray
    hidden: np.ndarray
    after: np.ndarray


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


SMOOTHED = 0.5  # seconds, over which a motion is smoothed
STANDS = 0.1  # m/s, below which an agent stands
PACES = 6  # at most, the one of standing among them
APART = 1.08  # ratio of a pace to the one before, at least
SAMPLE = 1_000_000  # speeds from which the paces are made, at most


def last_of(begins: np.ndarray) -> np.ndarray:
    """Return (k,) intp: for each row the last row of its run.

    begins: (k,) bool, whether a run begins there.
    """
    first = np.flatnonzero(begins)
    return np.repeat(np.append(first[1:], len(begins)) - 1, np.diff(np.append(first, len(begins))))


def first_of(begins: np.ndarray) -> np.ndarray:
    """Return (k,) intp: for each row the first row of its run."""
    first = np.flatnonzero(begins)
    return np.repeat(first, np.diff(np.append(first, len(begins))))


def velocities(
    x: np.ndarray, y: np.ndarray, seconds: np.ndarray, begins: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed velocities, m/s along x and along y, each (k,) float32.

    A row's is that of the straight way between the rows a quarter of a second before and after it,
    or the next rows of its run; 0 where it has none.

    seconds: (k,) float64, of the rows.
    step: seconds from one row to the next, as most are.
    """
    near = max(round(SMOOTHED / 2 / step), 1) if step > 0 else 1
    rows = np.arange(len(x))
    first = first_of(begins)
    last = last_of(begins)
    # rows at the edges of runs, and those before and after them in their run
    edge = np.flatnonzero((rows - near < first) | (rows + near > last))
    before = np.maximum(edge - near, first[edge])
    after = np.minimum(edge + near, last[edge])

    def change(values: np.ndarray) -> np.ndarray:
        difference = np.empty(len(values))
        difference[near : len(values) - near] = values[2 * near :] - values[: -2 * near]
        difference[edge] = values[after] - values[before]
        return difference

    passed = change(seconds)
    passed[passed == 0] = np.inf
    vx = (change(x) / passed).astype(np.float32)
    vy = (change(y) / passed).astype(np.float32)
    return vx, vy


def headings(
    vx: np.ndarray, vy: np.ndarray, moving: np.ndarray, agent: np.ndarray, ids: np.ndarray
) -> np.ndarray:
    """Return where agents face, (k,) float32 radians: along their motion.

    An agent that stands faces as when it walked last; before it walks, where it will walk. One that
    never walks faces anywhere.
    """
    rows = np.arange(len(vx))
    walked = np.maximum.accumulate(np.where(moving, rows, -1))
    first = np.flatnonzero(np.diff(agent, prepend=-1))
    strange = walked < first[agent]  # another agent's row, or none
    if strange.any():
        coming = np.minimum.accumulate(np.where(moving, rows, len(rows))[::-1])[::-1]
        walked = np.where(strange, coming, walked)
        is_own = walked < np.append(first, len(rows))[agent + 1]
        walked = np.where(is_own, walked, first[agent])
    heading = np.arctan2(vy, vx)
    still = np.flatnonzero(np.add.reduceat(moving, first, dtype=np.intp) == 0)
    keys = random_streams.keys_of(0, ids[still])
    heading[first[still]] = random_streams.uniform(keys, random_streams.LOOKS) * 2 * np.pi - np.pi
    return heading[walked]


def turns(values: np.ndarray, round_about: float) -> np.ndarray:
    """Return by how much `values` change to the next row, the shorter way about a circle, (k,).

    0 at the last row.
    """
    change = np.diff(values, append=values[-1:])
    return change - round_about * np.rint(change / round_about)


def sum_by_agent(change: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Return (k,) float64: the sum of `change` over the agent's rows before each row.

    begins: where agents begin.
    """
    total = np.append(0.0, np.cumsum(change, dtype=np.float64)[:-1])
    return total - total[first_of(begins)]


def ladder(speed: np.ndarray) -> np.ndarray:
    """Return the paces at which agents play their walk, (P,) float64 m/s, increasing from 0.

    speed: (k,) m/s of rows at which agents walk.
    """
    paces = [0.0]
    if len(speed):
        sample = speed[:: -(-len(speed) // SAMPLE)].astype(np.float64)
        parts = (np.arange(PACES - 1) + 0.5) / (PACES - 1)
        for pace in np.quantile(sample, parts).round(3).tolist():
            if pace >= max(paces[-1] * APART, STANDS / 2):
                paces.append(pace)
    return np.array(paces)


def paces_of(speed: np.ndarray, begins: np.ndarray, paces: np.ndarray) -> np.ndarray:
    """Return each row's pace, (k,) uint8.

    It is the nearest at first, then another where that is nearer by a quarter of the step.

    speed: (k,) float32 m/s.
    begins: (k,) bool, where agents begin.
    """
    pace = np.zeros(len(speed), np.uint8)
    rows = np.arange(len(speed))
    for low, high in zip(paces[:-1], paces[1:], strict=True):
        middle = np.float32((low + high) / 2)
        band = np.float32((high - low) / 8)
        above = speed > middle
        sure = np.abs(speed - middle) > band
        sure |= begins
        pace += above[np.maximum.accumulate(np.where(sure, rows, 0))]
    return pace


Places = slice | np.ndarray  # of values in a column: (m,) intp, or where they follow one another


@dataclass(frozen=True, eq=False)
class Tracks:
    """The agents of a file of tracks.

    ids: (n,) int64, increasing.
    samples: of all agents.
    classes: (first sample, one past the last, longest) of each class of intervals, the latter in
        frames.
    ends: (2, n) intp, the sample at which each agent enters, and that at which it leaves.
    rate: frames of the file a second.
    paces: (P,) float64 m/s.
    phased: whether TrackSamples.way counts cycles.
    group: (n,) whole numbers or texts, what the file tells of each agent's group, or None.
    note: a sentence on the file.
    meters: in the unit of its lengths, see in_units.
    until: as in Rows.
    """

    ids: np.ndarray
    samples: TrackSamples
    classes: tuple[tuple[int, int, float], ...]
    ends: np.ndarray
    rate: float
    paces: np.ndarray
    phased: bool
    group: np.ndarray | None
    note: str
    meters: float = 1.0
    until: float = -np.inf

    def in_units(self, meters: float) -> "Tracks":
        """Return the same tracks, which are in meters, in units of `meters`."""
        if meters == 1:
            return self
        old = self.samples
        z = None if old.z is None else old.z / meters
        way = old.way if self.phased else old.way / np.float32(meters)
        samples = replace(old, x=old.x / meters, y=old.y / meters, z=z, way=way)
        return replace(self, samples=samples, paces=self.paces / meters, meters=meters)

    @cached_property
    def first(self) -> float:
        """The first frame."""
        return float(self.samples.frame[self.ends[0]].min())

    @cached_property
    def last(self) -> float:
        """The last frame."""
        return max(float(self.samples.frame[self.ends[1]].max()), self.until)

    @cached_property
    def bounds(self) -> StepBounds:
        """How fast agents move at most, by the time."""
        return StepBounds(self.samples, self.classes, (self.first, self.last), self.rate)

    @cached_property
    def spread(self) -> np.ndarray:
        """(2, 3) float64 meters, the least and the greatest x, y and z.

        z is 0 if the file has none.
        """
        samples = self.samples
        z = np.zeros(1) if samples.z is None else samples.z
        places = [samples.x, samples.y, z]
        return np.array([[place.min() for place in places], [place.max() for place in places]])

    @cached_property
    def digest(self) -> bytes:
        """Of all that the crowd at any time follows from."""
        digest = hashlib.sha256(repr((self.rate, self.phased, self.until)).encode())
        group = None if self.group is None else self.group.astype(str)
        for column in (self.ids, self.paces, group, *vars(self.samples).values()):
            digest.update(b"\0" if column is None else column.tobytes())
        return digest.digest()

    def holding(self, frame: float) -> Places:
        """Return the samples (m,) whose interval holds `frame`, of each agent one at most.

        An agent's last sample holds at its own frame alone.
        """
        runs: list[Places] = []
        for begin, end, longest in self.classes:
            frames = self.samples.frame[begin:end]
            edges = np.searchsorted(frames, [frame - longest, frame], side="right") + begin
            since, until = edges.tolist()
            after = self.samples.after[since:until]
            holds = self.samples.frame[after] > frame
            if holds.all():
                runs += [slice(since, until)] if until > since else []
            else:
                places = np.arange(since, until)
                holds |= (after == places) & (self.samples.frame[since:until] == frame)
                runs.append(places[holds])
        if len(runs) == 1:
            return runs[0]
        indices = [np.r_[run] if isinstance(run, slice) else run for run in runs]
        return np.concatenate([np.empty(0, np.intp), *indices])


def in_a_row(places: np.ndarray) -> Places:
    """Return the `places` (m,) as a slice, if each is the one after that before it."""
    if (
        len(places)
        and places[-1] - places[0] == len(places) - 1
        and (places[1:] - places[:-1] == 1).all()
    ):
        return slice(int(places[0]), int(places[-1]) + 1)
    return places.astype(np.intp)
