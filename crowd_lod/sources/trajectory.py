"""What all trajectories share: the crowd at any time, and what is known of its motion."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd import random_streams
from ..crowd.agents import Crowd, Group
from ..crowd.bounds import Spheres, VelocityBounds, spheres_of
from ..errors import CrowdError
from ..world.maps import Area
from ..world.terrain import Ground

# So many times the planner's blocks are made before their agents are ordered anew.
PART = 4


@dataclass(frozen=True)
class States:
    """What agents do, as Crowd.state counts them.

    names: S names.
    colors: (S, 3) uint8.
    """

    names: tuple[str, ...]
    colors: np.ndarray


class Trajectory(ABC):
    """The crowd at any time: a pure function of the frame.

    Time is in frames and may be fractional. Blender may call this from several threads.

    start: the crowd at the first frame.
    groups: the character groups, which Crowd.group counts.
    seconds_per_frame: of the scene.
    first_frame: before it the crowd stands as at it.
    every: so many frames the planner's blocks hold (frame/index_cache.py).
    still: whether nobody ever moves or changes its state, once the first step has taken who stands
        beside the area onto it.
    stays: whether nobody ever moves, whatever its state.
    area: a rectangle that the crowd stays on.
    heights: the ground that agents stand on, a height map or a terrain; None if it is level.
    gaits: at which rates the groups play their actions.
    states: what agents do.
    wearer: (n,) intp, for each agent that which wears it; for one that nobody wears itself. None
        if nobody wears anything.
    given_phases: (n,) bool, agents whose phases come from a file or from an object's points; None
        if nobody's do.
    ids: (n,) int64, the numbers of a file or of an object's points, which agents keep when others
        are added; below 0 for agents without one. None where agents are known by their index alone.
    """

    start: Crowd
    groups: tuple[Group, ...]
    seconds_per_frame: float
    first_frame: int
    every: int
    heights: Ground | None
    gaits: Gaits
    still: bool = False
    stays: bool = False
    ids: np.ndarray | None = None
    given_phases: np.ndarray | None = None
    wearer: np.ndarray | None = None

    @property
    @abstractmethod
    def area(self) -> Area: ...

    @property
    @abstractmethod
    def states(self) -> States: ...

    @abstractmethod
    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return bounds of all agents' velocities between two times, in frames; None if they are
        not known.
        """

    @abstractmethod
    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames."""

    @abstractmethod
    def digests(self) -> dict[str, bytes]:
        """Return all that `at` follows from, by names that complete "... changed".

        A shot plan is made for these.
        """

    def kept_at(self, frame: int) -> Crowd:
        """Return the crowd at a whole `frame`, counted from the first."""
        return self.at(self.first_frame + frame)

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Do what `at` needs at `time`, in frames, as far as it takes long; then call `then`.

        Yields the progress, 0 to 1. It may be closed at any time.
        """
        self.at(time)
        then()
        yield 1.0

    def most_moved(self, times: Sequence[float]) -> float:
        """Return meters that no agent walks between two neighboring `times`, in frames.

        It is the distance of the whole gap, not of half of it. So an agent that jumps to the other
        side of a wrapping map is covered before and after.
        """
        if len(times) < 2:
            return 0.0
        velocity = self.velocity(min(times), max(times))
        if velocity is not None:
            return velocity.speed * max(np.diff(times)) * self.seconds_per_frame
        crowds = [self.at(time) for time in times]
        steps = (
            np.hypot(b.x - a.x, b.y - a.y).max(initial=0.0)
            for a, b in zip(crowds[:-1], crowds[1:], strict=True)
        )
        return float(max(steps))

    def tilt(self, crowd: Crowd, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (pitch, roll) of `agents` (m,) who stand square on their ground.

        Each is (m,) float32, radians; see height_map.lean. None if all stand upright.
        """
        return None

    def ground(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the height of the ground under `agents` (m,) of the `crowd`, (m,) float64 meters.

        None if all keep a height of their own wherever they are moved to.
        """
        return None

    def regrouped(self, group: np.ndarray) -> "Trajectory":
        """Return the same crowd with its agents in the groups `group`, (n,) uint8.

        CrowdError where their source alone decides on groups.
        """
        raise CrowdError("The source of these agents alone decides on their groups.")

    @property
    def bare(self) -> "Trajectory":
        """The agents without what they wear."""
        return self

    def with_worn(self, agents: np.ndarray) -> np.ndarray:
        """Return `agents` (m,) and the parts that they wear, (k,) intp, increasing."""
        return agents if self.wearer is None else np.flatnonzero(np.isin(self.wearer, agents))

    @property
    def note(self) -> str:
        """A sentence for Populate on where the agents come from, or ""."""
        return ""

    @property
    def level(self) -> bool:
        """Whether nobody ever leaves its height."""
        return False

    @property
    def wraps(self) -> bool:
        """Whether agents that leave the area come back at its other side."""
        return False

    @property
    def parts(self) -> tuple["Trajectory", ...]:
        """The trajectories that this one is made of, down to those that move agents."""
        return (self,)

    def jumped(self, now: Crowd, before: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return which of `agents` (m,) came back at the other side of their area since `before`,
        (m,) bool.

        None where that cannot happen.
        """
        return None

    def phase(
        self, crowd: Crowd, time: float, agents: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Return the phases of `agents` in their action's cycle, (m,) float32 in [0, 1).

        crowd: the crowd that holds the agents.
        time: in frames; it may lie before the first frame, where characters are posed as anywhere
            else.
        agents: (m,) indices, or all.
        """
        return self.gaits.phase(crowd, self.seconds(time), agents)

    def seconds(self, time: float) -> float:
        """Return the seconds from frame 0 to `time`, in frames.

        Actions count from frame 0, whichever frame is the crowd's first.
        """
        return time * self.seconds_per_frame

    @cached_property
    def spheres(self) -> Spheres:
        """The groups' bounding spheres."""
        return spheres_of(self.groups)

    def scale(self, crowd: Crowd, agents: np.ndarray) -> np.ndarray | None:
        """Return the sizes of `agents` (m,) in `crowd`, (m,) float32, 1 as their characters are.

        None if all are so.

        Drawn from each agent's first key, within the range of its group.
        """
        ranges = np.array([group.scale for group in self.groups], np.float32)
        if (ranges == 1).all():
            return None
        low, high = ranges[crowd.group[agents]].T
        return (low + (high - low) * self._sizes[agents]).clip(low, high)

    @cached_property
    def _sizes(self) -> np.ndarray:
        return random_streams.uniform(self.start.key, random_streams.SIZE).astype(np.float32)

    @cached_property
    def looks(self) -> np.ndarray:
        """Return a random number for each agent, (n,) float32 in [0, 1)."""
        return random_streams.uniform(self.start.key, random_streams.LOOKS).astype(np.float32)
