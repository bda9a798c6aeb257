"""The crowd that a file of tracks moves."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ..animation.phase_classes import cycles_of, gaits_of
from ..crowd import random_streams
from ..crowd.agents import CLASSES, Crowd, Group
from ..crowd.bounds import VelocityBounds
from ..crowd.paces import Paces
from ..progress import check_cancelled
from ..tracks.tracks import Tracks, in_a_row
from ..world.maps import Area
from ..world.terrain import Ground, Terrain
from .trajectory import States, Trajectory

STATES = States(("stands", "walks"), np.array([[230, 159, 0], [0, 114, 178]], np.uint8))
AROUND = 0.5  # meters about all places: a crowd of one that stands has an area, too
FINEST = 10**6  # the largest whole number that file frames a scene's frame are a ratio of


@dataclass(eq=False)
class Recorded(Trajectory):
    """The agents of tracks, each at the place of its rows, in a straight line between two of them.

    The first frame of the file is played at `first_frame`; before it, and after the last, the crowd
    stands as in it. Agents are in the order of their ids.

    group: (n,) uint8, the index of each agent's character group.
    seed: of the agents' random draws.
    offset: (x, y, z) meters, added to all places.
    heights: the ground that agents stand on; None for a level one, and for a height map if the file
        has z. On a terrain an agent stands on the floor that it gets to from the file's z, or else
        from its floor at the row before.
    tilts: whether agents stand square on the slopes of the ground.
    waiting: the action of who stands, which all groups with agents know; "" for their own, in whose
        pose they pause.
    """

    tracks: Tracks
    groups: tuple[Group, ...]
    group: np.ndarray
    seconds_per_frame: float
    first_frame: int = 1
    seed: int = 0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heights: Ground | None = None
    tilts: bool = False
    waiting: str = ""
    every: int = 16

    def __post_init__(self) -> None:
        tracks = self.tracks
        samples = tracks.samples
        if samples.z is not None and not isinstance(self.heights, Terrain):
            self.heights = None  # the file tells where agents stand
        self.ids = tracks.ids
        count = len(tracks.ids)
        self.given_phases = np.ones(count, bool) if tracks.phased else None
        key = random_streams.keys_of(self.seed, tracks.ids)
        actions = (self.waiting, *[""] * (len(tracks.paces) - 1)) if self.waiting else ()
        paces = Paces(tracks.paces, np.zeros((0, 0), np.uint8), actions=actions)
        self.gaits = gaits_of(self.groups, paces, CLASSES, np.unique(self.group))
        self._per_meter = cycles_of(self.groups)[self.group, 0]
        self._begun = random_streams.uniform(key, random_streams.STATE)  # cycles
        ratio = Fraction(self.seconds_per_frame * tracks.rate).limit_denominator(FINEST)
        self._ratio = self.seconds_per_frame * tracks.rate, 1.0
        if ratio:
            self._ratio = float(ratio.numerator), float(ratio.denominator)
        self._ends = samples.frame[tracks.ends]
        # of each column, the values at which agents enter, and at which they leave
        names = ("x", "y", "z", "heading", "way")
        self._at_ends = {
            name: getattr(samples, name)[tracks.ends]
            for name in names
            if getattr(samples, name) is not None
        }
        self._fixed = {
            "group": self.group.astype(np.uint8),
            "key": key,
            "wait": np.full(count, np.inf),
            "mirror": np.zeros(count, np.uint8),
        }
        self._at_level = np.full(count, float(self.offset[2]))
        self._lasts = self._floors()
        (x_min, y_min, z_min), (x_max, y_max, _) = (tracks.spread + self.offset).tolist()
        around = AROUND / tracks.meters
        self._area = Area(x_min - around, y_min - around, x_max + around, y_max + around, z_min)
        self._latest: tuple[float, Crowd] | None = None
        self.start = self.at(self.first_frame)

    def file_frame(self, time: float) -> float:
        """Return the frame of the file, whole or not, that is played at a frame of the scene."""
        times, by = self._ratio
        return self.tracks.first + (time - self.first_frame) * times / by

    def scene_frame(self, frame: float) -> float:
        """Return the time, in frames of the scene, at which `frame` of the file is played."""
        times, by = self._ratio
        return self.first_frame + (frame - self.tracks.first) * by / times

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames."""
        latest = self._latest
        if latest is None or latest[0] != time:
            latest = time, self._crowd_at(time)
            self._latest = latest
        return latest[1]

    def digests(self) -> dict[str, bytes]:
        """Return all samples, who the agents are and where, and the ground."""
        settings = self.first_frame, self.seconds_per_frame, self.seed, self.offset, self.tilts
        digests = {
            "the tracks": self.tracks.digest,
            "the crowd": f"{settings}{self.waiting}".encode() + self.group.tobytes(),
        }
        if isinstance(self.heights, Terrain):
            digests["the terrain"] = self.heights.digest()
        elif self.heights is not None:
            area = repr(self.heights.area).encode()
            digests["the height map"] = area + self.heights.digest()
        return digests

    def regrouped(self, group: np.ndarray) -> "Recorded":
        """Return the same crowd with its agents in the groups `group`."""
        return replace(self, group=group)

    @property
    def area(self) -> Area:
        """The rectangle about all places."""
        return self._area

    @property
    def states(self) -> States:
        """Whether agents stand or walk."""
        return STATES

    @property
    def level(self) -> bool:
        """Whether neither the file nor a ground tells where agents stand."""
        return self.tracks.samples.z is None and self.heights is None

    @property
    def note(self) -> str:
        """What the file has, and which frames of the scene play it."""
        first = self.scene_frame(self.tracks.first)
        last = self.scene_frame(self.tracks.last)
        return f"{self.tracks.note} It plays from frame {first:.6g} to {last:.6g} of the scene."

    def velocity(self, since: float, until: float) -> VelocityBounds:
        """Return the bounds of the steps between rows in that time, and of the ground's climbs."""
        bounds = self.tracks.bounds.between(self.file_frame(since), self.file_frame(until))
        if self.heights is None:
            return bounds
        if isinstance(self.heights, Terrain):  # which may have steps of any height
            lowest, highest = self.heights.span
            level = np.array((1, 1, 0))
            return VelocityBounds(
                bounds.low * level, bounds.high * level, bounds.fastest, highest - lowest
            )
        fastest = np.maximum(-bounds.low, bounds.high)[:2]
        climb = (np.array(self.heights.steepest) * fastest).sum()
        low = np.append(bounds.low[:2], -climb)
        high = np.append(bounds.high[:2], climb)
        return VelocityBounds(low, high, bounds.fastest)

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents` on the ground, if they align to its slopes."""
        if not self.tilts or self.heights is None:
            return None
        return self.heights.tilt(
            crowd.x[agents], crowd.y[agents], crowd.heading[agents], crowd.z[agents]
        )

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the height of the ground under `agents`."""
        if self.heights is None:
            return None
        return self.heights.at(crowd.x[agents], crowd.y[agents], crowd.z[agents])

    def _crowd_at(self, time: float) -> Crowd:
        tracks = self.tracks
        samples = tracks.samples
        count = len(tracks.ids)
        file_frame = self.file_frame(time)
        frame = min(max(file_frame, tracks.first), tracks.last)
        rows = tracks.holding(frame)
        agent = in_a_row(samples.agent[rows])
        after = in_a_row(samples.after[rows])
        since = samples.frame[rows]
        passed = samples.frame[after] - since
        part = np.divide(frame - since, passed, out=np.zeros(len(since)), where=passed > 0)
        left = self._ends[1] < frame if len(since) < count else None

        def around(enters: np.ndarray, leaves: np.ndarray) -> np.ndarray:
            """Return a column of who is not there."""
            return np.empty_like(enters) if left is None else np.where(left, leaves, enters)

        def between(name: str, aside: float = 0.0) -> np.ndarray:
            values = getattr(samples, name)
            column = around(*self._at_ends[name])
            begin = values[rows]
            column[agent] = begin + part * (values[after] - begin)
            return column + aside if aside else column

        def of_row(values: np.ndarray) -> np.ndarray:
            column = np.zeros(count, np.uint8)
            if frame == file_frame:  # before the first frame and after the last nobody walks
                column[agent] = values[rows]
            return column

        x = between("x", self.offset[0])
        y = between("y", self.offset[1])
        heading = around(*self._at_ends["heading"])
        heading[agent] = samples.heading[rows] + part.astype(np.float32) * samples.turn[rows]
        z = self._at_level
        if self.heights is not None:
            last = None
            if self._lasts is not None:
                last = around(*self._lasts[tracks.ends])
                last[agent] = self._lasts[rows]
            z = self.heights.at(x, y, last)
        elif samples.z is not None:
            z = between("z", self.offset[2])
        pace = of_row(samples.pace)
        present = np.zeros(count, bool)
        present[agent] = ~samples.hidden[rows]
        return Crowd(
            x,
            y,
            z,
            heading,
            state=of_row(samples.walks),
            phase_class=self._classes(between("way"), pace, time),
            pace=pace,
            present=None if present.all() else present,
            **self._fixed,
        )

    def _floors(self) -> np.ndarray | None:
        """Return the last height of each sample, (k,) meters, from which its agent gets to a floor.

        None on a single floor.
        """
        samples = self.tracks.samples
        ground = self.heights
        if ground is None or not ground.layered:
            return None
        if samples.z is not None:
            return samples.z + self.offset[2]
        heights = np.empty(len(samples.x))
        rows = self.tracks.ends[0]
        last = self._at_level
        while len(rows):
            check_cancelled()
            x = samples.x[rows] + self.offset[0]
            y = samples.y[rows] + self.offset[1]
            heights[rows] = ground.at(x, y, last)
            goes_on = samples.after[rows] != rows
            last = heights[rows[goes_on]]
            rows = samples.after[rows[goes_on]].astype(np.intp)
        return heights

    def _classes(self, way: np.ndarray, pace: np.ndarray, time: float) -> np.ndarray:
        """Return the phase classes (n,) uint8 whose poses at `time` are nearest to those walked.

        way: (n,), as in TrackSamples. A group without a stride plays by time, and its agents keep
            their class.
        """
        seconds = self.seconds(time)
        if self.tracks.phased:
            cycles = way - self.gaits.rates[self._fixed["group"], pace] * seconds
        else:
            walked = self._per_meter * (way - (self.tracks.paces * seconds)[pace])
            if self.waiting:  # which plays by time
                walked[pace == 0] = 0
            cycles = self._begun + walked
        whole = np.rint(cycles * CLASSES).astype(np.int64)
        return whole.astype(np.uint8) % np.uint8(CLASSES)  # of which a byte holds a whole number
