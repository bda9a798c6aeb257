"""What Make LOD Meshes has done and has yet to do, weighed by the time that it takes."""

from collections.abc import Generator
from dataclasses import dataclass

from ...crowd_lod.progress import Made, share

BEGUN = 0.02  # progress at which the source meshes are read
# Seconds on a slow machine: of reading a character, for each thousand of its triangles; of work on
# one of its LODs, for the square root of these thousands.
READ = 0.11
SEARCH = 2.3  # finding the LOD of a length
MAKE = 0.4  # making the LOD of a ratio, and measuring it
LOOK = 0.07  # looking at the LOD of a ratio between the poses
FURTHER = 0.35  # searches that the result of a search calls for, on average


@dataclass(frozen=True)
class Costs:
    """What the work on one character costs.

    triangles: that it has; searched: whether its LODs are of lengths, not of ratios; count: of its
    LODs by distance.
    """

    triangles: int = 0
    searched: bool = False
    count: int = 0

    @property
    def read(self) -> float:
        """That of reading the character in its poses."""
        return READ * self.triangles / 1000

    @property
    def make(self) -> float:
        """That of making and measuring one LOD."""
        return self._size * (SEARCH if self.searched else MAKE)

    @property
    def further(self) -> float:
        """That of further searches, while there are some."""
        return self._size * SEARCH * FURTHER if self.searched else 0.0

    @property
    def look(self) -> float:
        """That of looking at all LODs between the poses."""
        return 0.0 if self.searched else self._size * LOOK * self.count

    @property
    def expected(self) -> float:
        """That of all work after reading, as far as is known before it."""
        return self.look + (self.make + self.further) * (1 if self.searched else self.count - 1)

    @property
    def _size(self) -> float:
        return (self.triangles / 1000) ** 0.5


@dataclass
class Workload:
    """Work in parts, whose number becomes known on the way.

    done, left: what the parts cost. When `left` grows the progress goes back, so that the time left
    stays true.
    """

    done: float = 0.0
    left: float = 0.0

    def take(
        self, steps: Generator[float, None, Made], cost: float
    ) -> Generator[float, None, Made]:
        """Take the steps of a part of that cost: yield the progress of all, return the result."""
        result = yield from share(steps, self._progress(0.0), self._progress(cost))
        self.done += cost
        self.left = max(self.left - cost, 0.0)
        return result

    def _progress(self, more: float) -> float:
        """Return the progress when `more` than what is done now will be done."""
        done = self.done + more
        return BEGUN + (1 - BEGUN) * done / max(self.done + self.left, done, 1e-9)
