"""A trajectory about another one, whose agents move as that one's do."""

from collections.abc import Callable, Generator, Sequence

from ..crowd.agents import Crowd
from ..world.maps import Area
from .trajectory import States, Trajectory


class AroundTrajectory(Trajectory):
    """A trajectory that changes the crowds of another one, and nothing of how they come about.

    base: the other one.
    """

    base: Trajectory

    @property
    def area(self) -> Area:
        """That of the other one; who is moved may stand beside it."""
        return self.base.area

    @property
    def states(self) -> States:
        """Those of the other one."""
        return self.base.states

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        """Those of the other one."""
        return self.base.parts

    @property
    def level(self) -> bool:
        """Whether nobody ever leaves its height."""
        return self.base.level

    @property
    def wraps(self) -> bool:
        """Whether agents come back at the other side of the area."""
        return self.base.wraps

    def at(self, time: float) -> Crowd:
        """Return the crowd at `time`, in frames."""
        return self._of(self.base.at(time))

    def kept_at(self, frame: int) -> Crowd:
        """Return the crowd at a whole `frame`, counted from the first."""
        return self._of(self.base.kept_at(frame))

    def approach(
        self, time: float, then: Callable[[], object] = lambda: None
    ) -> Generator[float, None, None]:
        """Do what `at` needs."""
        yield from self.base.approach(time, then)

    def most_moved(self, times: Sequence[float]) -> float:
        """Return the other one's."""
        return self.base.most_moved(times)

    def _of(self, crowd: Crowd) -> Crowd:
        """Return `crowd`, of the other one, as it is here."""
        raise NotImplementedError
