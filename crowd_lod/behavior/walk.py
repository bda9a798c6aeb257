"""The crowd that the state machine moves, cached forward from the first frame."""

import operator
import threading
import time as clock
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..animation.phase_classes import gaits_of
from ..crowd.agents import CLASSES, Crowd, Group
from ..crowd.bounds import STANDING, VelocityBounds
from ..crowd.state_machine import StateMachine
from ..progress import run_in_thread
from ..sources.trajectory import PART, States, Trajectory
from ..world.first_frame import stays_still
from ..world.maps import Area, LabelMap
from ..world.terrain import Ground, Terrain
from .plain_step import look_up_paces
from .step import step

# Bytes of the crowds that a walk keeps to go back to, beyond which it keeps fewer.
MOST_KEPT = 2**30
# A thread on a long way to a frame steps for TURN seconds, then lets others step for REST seconds,
# the drawing of a viewport among them.
TURN = 0.1
REST = 0.001


def bounds_of_walk(machine: StateMachine, heights: Ground | None) -> VelocityBounds:
    """Return how fast the table lets agents walk, and the ground lets them climb.

    A terrain may have steps of any height.
    """
    velocity = machine.velocity.reshape(-1, 2)
    fastest = float(np.linalg.norm(velocity, axis=-1).max())
    low = velocity.min(axis=0, initial=0)
    high = velocity.max(axis=0, initial=0)
    if machine.edge == "reflect":
        high = np.maximum(high, -low)
        low = -high
    if isinstance(heights, Terrain):
        lowest, highest = heights.span
        return VelocityBounds(np.append(low, 0.0), np.append(high, 0.0), fastest, highest - lowest)
    climb = 0.0
    if heights is not None:
        climb = (np.array(heights.steepest) * np.maximum(-low, high)).sum()
    return VelocityBounds(np.append(low, -climb), np.append(high, climb), fastest)


@dataclass(eq=False)
class Walk(Trajectory):
    """The crowd that the state machine moves over its map, cached from the first frame on.

    At a fractional time the last step is taken in part. Before `first_frame` the crowd stands as
    populated. On a height map or a terrain agents stand on the ground. Where floors lie over each
    other, an agent's height follows from its last one, step by step.

    every: frames between two crowds that are kept, so that going back is cheap; fewer are kept in a
        long shot of a large crowd (MOST_KEPT).
    tilts: whether agents stand square on the slopes of the ground.
    seated: whether all stay where they start, height and heading too, on the map or not; the state
        machine then only changes their states.
    classes: number of phase classes (animation/phase_classes.py).
    """

    start: Crowd
    machine: StateMachine
    world: LabelMap
    groups: tuple[Group, ...]
    seconds_per_frame: float
    first_frame: int = 1
    every: int = 16
    heights: Ground | None = None
    tilts: bool = False
    classes: int = CLASSES
    seated: bool = False

    def __post_init__(self) -> None:
        self.gaits = gaits_of(self.groups, self.machine.paces, self.classes, self.start.group)
        # where floors lie over each other, the height is part of each step
        layered = self.heights is not None and not self.seated and self.heights.layered
        self._floors = self.heights if layered else None
        self._place_start()
        self.still = stays_still(self.start, self.machine, self.world)
        self.stays = self.seated or self.still
        self._fade_start()
        # on the map, where the state machine knows them
        self._first = _onto(self.world.area, self.start) if self.seated else self.start
        self._lock = threading.Lock()
        # frames, counted from 0, and their crowds
        self._kept: dict[int, Crowd] = {0: self._first}
        # the latest, and the one before it once that has been asked for, as open shutters do
        self._recent: tuple[tuple[int, Crowd], ...] = ((0, self._first),)
        self._looks_back = False
        # of a crowd that stands still: its x, and the ground's z there
        self._ground: tuple[np.ndarray, np.ndarray] | None = None
        self._regrouped: Walk | None = None  # the last that was asked for

    def _place_start(self) -> None:
        """Give the agents of the start their paces, and their heights on the floors."""
        for axis in "xy":
            place = getattr(self.start, axis)
            # who stands beyond the map is taken onto it, but from infinity nobody comes back
            if np.isinf(place).any():
                self.start = replace(self.start, **{axis: np.where(np.isinf(place), np.nan, place)})
        start = self.start
        pace = look_up_paces(start.x, start.y, start.state, self.machine, self.world)
        z = start.z if self._floors is None else self._floors.at(start.x, start.y, start.z)
        self.start = replace(start, pace=pace, z=z)

    def _fade_start(self) -> None:
        """Give the agents of the start the columns of cross-fades, if the machine has any."""
        pace = self.start.pace
        if not len(self.machine.paces.fades):
            self.start = replace(self.start, played=None, faded=None)
        elif self.start.played is None:
            self.start = replace(self.start, played=pace, faded=np.ones(len(pace), np.float32))

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames."""
        whole, part = divmod(max(time - self.first_frame, 0.0), 1.0)
        crowd = self._at_whole(int(whole))
        crowd = self._step(crowd, part, int(whole)) if part else crowd
        return self._on_ground(crowd)

    def _on_ground(self, crowd: Crowd) -> Crowd:
        if self.seated:
            start = self.start
            return replace(crowd, x=start.x, y=start.y, z=start.z, heading=start.heading)
        if self.heights is None or self._floors is not None:
            return crowd
        if self._ground is not None and self._ground[0] is crowd.x:
            return replace(crowd, z=self._ground[1])
        z = self.heights.at(crowd.x, crowd.y)
        self._ground = (crowd.x, z) if self.still else None
        return replace(crowd, z=z)

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Compute the crowd at `time`, in frames, for `at` to find; then call `then`.

        Yields the progress, 0 to 1, where that takes long. It may be closed at any time.
        """
        target = int(max(time - self.first_frame, 0.0))
        with self._lock:
            begin = self._nearest(target)[0]

        def go() -> None:
            self.at(time)
            then()

        def progress() -> float:
            frames = self.reached - begin
            return min(max(frames, 0) / max(target - begin, 1), 1.0)

        yield from run_in_thread(go, progress)

    @property
    def reached(self) -> int:
        """The frame, counted from 0, whose crowd was computed last."""
        return self._recent[0][0]

    def kept_at(self, frame: int) -> Crowd:
        """Return the crowd at a whole `frame`, counted from 0."""
        crowd = self._kept.get(frame)
        return self._on_ground(self._at_whole(frame) if crowd is None else crowd)

    @cached_property
    def area(self) -> Area:
        """The map's, or one about all places where agents stay."""
        area = self.world.area
        if not self.seated:
            return area
        x = np.append(self.start.x, (area.x_min, area.x_max))
        y = np.append(self.start.y, (area.y_min, area.y_max))
        x = x[np.isfinite(x)]
        y = y[np.isfinite(y)]
        return Area(x.min(), y.min(), x.max(), y.max(), area.z)

    @property
    def states(self) -> States:
        """Those of the state machine."""
        return States(self.machine.states, self.machine.state_colors)

    def velocity(self, since: float, until: float) -> VelocityBounds:
        """Return how fast the table lets agents walk, and the ground climb: the same always."""
        return self._velocity

    @cached_property
    def _velocity(self) -> VelocityBounds:
        if self.stays:
            return STANDING
        return bounds_of_walk(self.machine, self.heights)

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents` on the ground, if they align to its slopes."""
        if not self.tilts or self.heights is None:
            return None
        return self.heights.tilt(
            crowd.x[agents], crowd.y[agents], crowd.heading[agents], crowd.z[agents]
        )

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the ground's height under `agents`; None where they keep that of their places."""
        if self.heights is None or self.seated:
            return None
        return self.heights.at(crowd.x[agents], crowd.y[agents], crowd.z[agents])

    def regrouped(self, group: np.ndarray) -> "Walk":
        """Return the same walk from its start on, with agents of other groups.

        They change their phase class by the rates of these groups.
        """
        if np.array_equal(group, self.start.group):
            return self
        walk = self._regrouped
        if walk is None or not np.array_equal(group, walk.start.group):
            walk = replace(self, start=replace(self.start, group=group))
            self._regrouped = walk
        return walk

    @property
    def level(self) -> bool:
        """Whether agents keep the height of their places: there is no ground, or they stay."""
        return self.heights is None or self.seated

    @property
    def wraps(self) -> bool:
        """Whether the map wraps around, and anybody walks."""
        return self.machine.edge == "wrap" and not self.seated

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` are half a map away from where they were."""
        if now is before or not self.wraps:
            return None
        width, depth = self.area.size
        along_x = np.abs(now.x[agents] - before.x[agents])
        along_y = np.abs(now.y[agents] - before.y[agents])
        return (along_x > width / 2) | (along_y > depth / 2)

    def digests(self) -> dict[str, bytes]:
        """Return the start, the state machine, the map, and the ground."""
        world = self.world
        start = replace(self.start, played=None, faded=None)
        columns = [column.tobytes() for column in start.columns.values()]
        digests = {
            "the crowd": b"".join([*columns, b"seated" * self.seated]),
            "the state machine": self.machine.content.encode(),
            "the map": repr((world.area, world.labels.shape)).encode() + world.labels.tobytes(),
            "the height map": b"",
        }
        if self.heights is not None:
            ground = "the terrain" if isinstance(self.heights, Terrain) else "the height map"
            digests[ground] = self.heights.digest()
        return digests

    def _step(self, crowd: Crowd, frames: float, since: int) -> Crowd:
        """Return the crowd `frames`, at most 1, after frame `since`, counted from 0."""
        # the first step takes who stands off the map onto it
        if self.still and crowd is not self._first:
            return crowd
        moved = step(crowd, self.machine, self.world, frames * self.seconds_per_frame)
        moved = self.gaits.continue_phases(
            crowd, moved, self.seconds(self.first_frame + since + frames)
        )
        if self._floors is not None:
            moved = replace(moved, z=_climbed(self._floors, crowd, moved))
        return moved

    def _keep(self, frame: int, crowd: Crowd) -> None:
        """Keep the crowd at `frame`; over MOST_KEPT bytes, drop every other run of frames.

        A run has as many frames as the planner keeps one order of its blocks, and its crowds go
        together: a later request for one of them computes all of the run again. The first run, and
        the run of `frame`, stay.
        """
        self._kept[frame] = crowd
        size = sum(
            column.nbytes
            for name, column in crowd.columns.items()
            if column is not getattr(self.start, name)
        )
        if len(self._kept) * size > MOST_KEPT:
            frames_a_run = PART * self.every
            runs = {kept_frame // frames_a_run for kept_frame in self._kept}
            dropped = set(sorted(runs - {0, frame // frames_a_run})[::2])
            for old_frame in list(self._kept):
                if old_frame // frames_a_run in dropped:
                    del self._kept[old_frame]

    def _at_whole(self, target: int) -> Crowd:
        """Return the crowd at a whole frame, counted from 0."""
        latest = self._recent[0]
        reached: tuple[tuple[int, Crowd], ...] = ()
        while True:
            with self._lock:
                looked_back = latest[0] - target == 1
                self._looks_back |= looked_back
                frame, crowd = self._step_toward(target, reached)
                if frame == target:
                    if looked_back:
                        self._recent = latest, (frame, crowd)
                    return crowd
            # what others ask for in between does not throw it back
            reached = ((frame, crowd),)
            clock.sleep(REST)

    def _nearest(self, target: int, *reached: tuple[int, Crowd]) -> tuple[int, Crowd]:
        """Return (frame, crowd) of the last known frame up to `target`, counted from 0.

        reached: further (frame, crowd) pairs.
        """
        frame = max(kept_frame for kept_frame in self._kept if kept_frame <= target)
        crowds = (frame, self._kept[frame]), *self._recent, *reached
        return max((pair for pair in crowds if pair[0] <= target), key=operator.itemgetter(0))

    def _step_toward(
        self, target: int, reached: tuple[tuple[int, Crowd], ...]
    ) -> tuple[int, Crowd]:
        """Return (frame, crowd) at `target`, or as far as one TURN of time reaches."""
        frame, crowd = self._nearest(target, *reached)
        until = clock.monotonic() + TURN
        while frame < target and clock.monotonic() < until:
            before = frame, crowd
            crowd = self._step(crowd, 1.0, frame)
            frame += 1
            if frame % self.every == 0 or (frame == 1 and self.still):
                self._keep(frame, crowd)
            self._recent = ((frame, crowd), before) if self._looks_back else ((frame, crowd),)
        return frame, crowd


def _climbed(floors: Ground, before: Crowd, after: Crowd) -> np.ndarray:
    """Return (n,) meters, the heights of the crowd `after`, which stood on `floors` as `before`."""
    z = before.z.copy()
    agents = np.flatnonzero((after.x != before.x) | (after.y != before.y))
    z[agents] = floors.at(after.x[agents], after.y[agents], before.z[agents])
    return z


def _onto(area: Area, crowd: Crowd) -> Crowd:
    """Return the crowd with those beyond the `area` on its border."""
    return replace(
        crowd,
        x=np.clip(crowd.x, area.x_min, area.x_max),
        y=np.clip(crowd.y, area.y_min, area.y_max),
    )


def walks_of(trajectory: Trajectory) -> list[Walk]:
    """Return the parts of `trajectory` that a state machine moves."""
    return [part for part in trajectory.parts if isinstance(part, Walk)]


def stray_places(trajectory: Trajectory) -> np.ndarray:
    """Return (k, 3) world meters of the middles of all cells painted in no label's color."""
    places = [np.empty((0, 3))]
    for walk in walks_of(trajectory):
        world = walk.world
        x, y = world.middles(*world.strays.T)
        places.append(np.column_stack([x, y, np.full(len(x), world.area.z)]))
    return np.concatenate(places)
