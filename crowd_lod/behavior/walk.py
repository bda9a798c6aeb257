"""The crowd that the state machine moves: steps of behavior, cached forward from the first
frame.
"""

import operator
import threading
import time as clock
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..animation.phase_classes import gaits_of
from ..crowd.agents import CLASSES, Crowd, Group
from ..crowd.leave_outs import ALL, NO_FADES, STILL, LeftOut, needless, needless_of_places
from ..crowd.maps import Area, LabelMap
from ..crowd.state_machine import StateMachine
from ..crowd.terrain import Ground, Terrain
from ..crowd.velocity_bounds import STANDING, VelocityBounds
from ..progress import aside
from ..sources.trajectory import PART, States, Trajectory
from .plain_step import look_up_paces
from .step import Steps

# Bytes of the crowds that a trajectory keeps to go back to, beyond which it keeps fewer.
MOST_KEPT = 2**30
# Seconds of a long way to a frame after which others, the drawing of a viewport among them, have
# their turn, and how many of it.
TURN, REST = 0.1, 0.001


def bounds_of_walk(machine: StateMachine, heights: Ground | None) -> VelocityBounds:
    """Return how fast the table lets agents walk, and the ground lets them climb.

    A terrain may have steps of any height.
    """
    velocity = machine.velocity.reshape(-1, 2)
    fastest = float(np.linalg.norm(velocity, axis=-1).max())
    low, high = velocity.min(axis=0, initial=0), velocity.max(axis=0, initial=0)
    if machine.edge == "reflect":
        low, high = np.minimum(low, -high), np.maximum(high, -low)
    climb = 0.0
    if isinstance(heights, Terrain):
        return VelocityBounds(
            np.append(low, 0.0), np.append(high, 0.0), fastest, heights.span[1] - heights.span[0]
        )
    if heights is not None:
        climb = (np.array(heights.steepest) * np.maximum(-low, high)).sum()
    return VelocityBounds(np.append(low, -climb), np.append(high, climb), fastest)


@dataclass(eq=False)
class Walk(Trajectory):
    """The crowd that the state machine moves over its map, cached from the first frame on.

    At a fractional time the last step is taken in part. Before `first_frame` the crowd stands as
    populated. On a height map or a terrain agents stand on the ground. Where floors lie over each
    other, an agent's height follows from its last one, step by step.

    every: one crowd is kept each so many frames, so that going back is cheap; fewer in a long shot
        of a large crowd (MOST_KEPT).
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
    leave: frozenset[LeftOut] = ALL
    classes: int = CLASSES
    seated: bool = False
    _kept: dict[int, Crowd] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        for axis in "xy":
            place = getattr(self.start, axis)
            # who stands beyond the map is taken onto it, but from infinity nobody comes back
            if np.isinf(place).any():
                self.start = replace(self.start, **{axis: np.where(np.isinf(place), np.nan, place)})
        self.gaits = gaits_of(self.groups, self.machine.paces, self.classes, self.start.group)
        pace = look_up_paces(self.start.x, self.start.y, self.start.state, self.machine, self.world)
        self.start = replace(self.start, pace=pace)
        # on several floors the height is part of each step
        self._floors = (
            None
            if self.heights is None or self.seated or not self.heights.layered
            else self.heights
        )
        if self._floors is not None:
            self.start = replace(
                self.start, z=self._floors.at(self.start.x, self.start.y, self.start.z)
            )
        found = needless_of_places(self.start, not self.level)
        self.left_out = self.leave and self.leave & (
            found | needless(self.start, self.machine, self.world)
        )
        if not len(self.machine.paces.fades) or NO_FADES in self.left_out:
            self.start = replace(self.start, played=None, faded=None)
        elif self.start.played is None:
            self.start = replace(self.start, played=pace, faded=np.ones(len(pace), np.float32))
        # on the map, where the state machine knows them
        self._first = _onto(self.world.area, self.start) if self.seated else self.start
        self._kept[0] = self._first
        # the latest, and the one before it once that has been asked for, as open shutters do
        self._recent: tuple[tuple[int, Crowd], ...] = ((0, self._first),)
        self._looks_back = False
        self._ground: tuple[np.ndarray, np.ndarray] | None = None  # x, and the ground's z there
        row = self.seconds_per_frame if self.leave else None
        self._steps = Steps(self.machine, self.world, row, self.left_out)
        self._regrouped: Walk | None = None  # the last that was asked for

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
        x, z = self._ground or (None, crowd.z)
        if crowd.x is not x:  # who stands still, stands on the ground found before
            z = self.heights.at(crowd.x, crowd.y)
            self._ground = (crowd.x, z) if STILL in self.left_out else None
        return replace(crowd, z=z)

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Compute the crowd at `time`, in frames, for `at` to find; then call `then`.

        Yields the progress, 0 to 1, where that takes long. It may be closed at any time.
        """
        target = int(max(time - self.first_frame, 0.0))
        with self._lock:
            begun = self._nearest(target)[0]

        def go() -> None:
            self.at(time)
            then()

        yield from aside(
            go, lambda: min(max(self._recent[0][0] - begun, 0) / max(target - begun, 1), 1.0)
        )

    @cached_property
    def full(self) -> "Trajectory":
        """Return the same trajectory with nothing left out."""
        return replace(self, leave=frozenset(), _kept={}, _lock=threading.Lock())

    def kept_at(self, frame: int) -> Crowd:
        """Return the crowd at a whole `frame`, counted from 0."""
        crowd = self._kept.get(frame)
        return self._on_ground(self._at_whole(frame) if crowd is None else crowd)

    def leaving(self, leave: frozenset[LeftOut], time: float) -> "Walk":
        """Return the same crowd from `time` on, a whole frame, with only `leave` left out.

        It looks no step ahead, which would be work for later frames: each step is made by itself.
        """
        bare = self._at_whole(int(max(time - self.first_frame, 0)))
        bare = self._on_ground(bare) if self.seated else bare
        walk = replace(
            self, start=bare, leave=leave, first_frame=int(time), _kept={}, _lock=threading.Lock()
        )
        walk.left_out = leave & self.left_out  # of the whole shot, not of what is still to come
        walk._steps = Steps(self.machine, self.world, None, walk.left_out)
        return walk

    @cached_property
    def area(self) -> Area:
        """The map's, or one about all places where agents stay."""
        area, start = self.world.area, self.start
        if not self.seated:
            return area
        x, y = (
            np.append(place[np.isfinite(place)], ends)
            for place, ends in zip((start.x, start.y), np.array(area.bounds)[..., 0].T, strict=True)
        )
        return Area(x.min(), y.min(), x.max(), y.max(), area.z)

    @property
    def states(self) -> States:
        """Those of the state machine."""
        return States(self.machine.states, self.machine.state_colors)

    def velocity(self, since: float, until: float) -> VelocityBounds:
        """Return how fast the table lets agents walk, and the ground lets them climb, at any
        time.
        """
        return self._velocity

    @cached_property
    def _velocity(self) -> VelocityBounds:
        return (
            STANDING
            if self.seated or STILL in self.left_out
            else bounds_of_walk(self.machine, self.heights)
        )

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
        other = self._regrouped
        if other is None or not np.array_equal(group, other.start.group):
            start = replace(self.start, group=group)
            other = self._regrouped = replace(self, start=start, _kept={}, _lock=threading.Lock())
        return other

    @property
    def level(self) -> bool:
        """Whether there is neither a height map nor a terrain, or all keep the height of their
        places.
        """
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
        aside, along = (
            np.abs(getattr(now, name)[agents] - getattr(before, name)[agents]) for name in "xy"
        )
        return (aside > width / 2) | (along > depth / 2)

    def digests(self) -> dict[str, bytes]:
        """Return the start, the state machine, the map, and the ground."""
        world, start, heights = (
            self.world,
            replace(self.start, played=None, faded=None),
            self.heights,
        )
        own = {
            "the crowd": b"".join(
                [*(column.tobytes() for column in start.columns.values()), b"seated" * self.seated]
            ),
            "the state machine": self.machine.content.encode(),
            "the map": repr((world.area, world.labels.shape)).encode() + world.labels.tobytes(),
            "the height map": b"",
        }
        ground = "the terrain" if isinstance(heights, Terrain) else "the height map"
        return own if heights is None else own | {ground: heights.digest()}

    def _step(self, crowd: Crowd, frames: float, since: int) -> Crowd:
        """Return the crowd `frames`, at most 1, after frame `since`, counted from 0."""
        # the first step takes who stands off the map onto it
        if STILL in self.left_out and crowd is not self._first:
            return crowd
        moved = self._steps.after(crowd, frames * self.seconds_per_frame)
        moved = self.gaits.joined(crowd, moved, self.seconds(self.first_frame + since + frames))
        if self._floors is not None:
            moved = replace(moved, z=_climbed(self._floors, crowd, moved))
        return moved

    def _keep(self, frame: int, crowd: Crowd) -> None:
        """Keep the crowd at `frame`; over MOST_KEPT bytes, drop every other part.

        All crowds between two orders of the planner's blocks are a part and go together, but never
        the first part nor this one's: a later request for a frame of a dropped part computes all of
        that part again.
        """
        self._kept[frame] = crowd
        own = sum(
            column.nbytes
            for name, column in crowd.columns.items()
            if column is not getattr(self.start, name)
        )
        if len(self._kept) * own > MOST_KEPT:
            part = PART * self.every
            parts = sorted({kept // part for kept in self._kept} - {0, frame // part})
            for gone in parts[::2]:
                for kept in [kept for kept in self._kept if kept // part == gone]:
                    del self._kept[kept]

    def _at_whole(self, target: int) -> Crowd:
        latest = self._recent[0]
        own: tuple[tuple[int, Crowd], ...] = ()
        while True:
            with self._lock:
                looked_back = latest[0] - target == 1
                self._looks_back |= looked_back
                frame, crowd = self._onward(target, own)
                if frame == target:
                    if looked_back:
                        self._recent = latest, (frame, crowd)
                    return crowd
            own = ((frame, crowd),)  # what others ask for in between does not throw it back
            clock.sleep(REST)

    def _nearest(self, target: int, *own: tuple[int, Crowd]) -> tuple[int, Crowd]:
        """Return (frame, crowd) of the last known frame up to `target`, counted from 0.

        own: further known (frame, crowd) pairs.
        """
        nearest = max(kept for kept in self._kept if kept <= target)
        known = (nearest, self._kept[nearest]), *self._recent, *own
        return max((each for each in known if each[0] <= target), key=operator.itemgetter(0))

    def _onward(self, target: int, own: tuple[tuple[int, Crowd], ...]) -> tuple[int, Crowd]:
        """Return (frame, crowd) at `target`, or as far as one TURN of time reaches."""
        (frame, crowd), until = self._nearest(target, *own), clock.monotonic() + TURN
        while frame < target and clock.monotonic() < until:
            before, frame, crowd = (frame, crowd), frame + 1, self._step(crowd, 1.0, frame)
            if frame % self.every == 0 or (frame == 1 and STILL in self.left_out):
                self._keep(frame, crowd)
            self._recent = ((frame, crowd), before) if self._looks_back else ((frame, crowd),)
        return frame, crowd


def _climbed(floors: Ground, before: Crowd, after: Crowd) -> np.ndarray:
    """Return the heights of the crowd `after`, (n,), which stood on one of the `floors` as
    `before`.
    """
    z, (agents,) = before.z.copy(), np.nonzero((after.x != before.x) | (after.y != before.y))
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
    worlds = [walk.world for walk in walks_of(trajectory)]
    found = [
        np.column_stack([*world.middles(*world.strays.T), np.full(len(world.strays), world.area.z)])
        for world in worlds
    ]
    return np.concatenate(found) if found else np.empty((0, 3))
