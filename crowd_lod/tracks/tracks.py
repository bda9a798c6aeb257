"""Tracks: where a file has its agents at any time, and how they move.

Every row of the file begins an interval, which ends at the agent's next row. Intervals are kept in
classes of like length, those of a class by when they begin. So those that hold at a time lie
together, whoever is there, and a crowd that enters and leaves costs no more than who is present.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .samples import TrackSamples
from .step_bounds import StepBounds

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
        return float(self.samples.frame[self.ends[1]].max())

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
        digest = hashlib.sha256(repr((self.rate, self.phased)).encode())
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
