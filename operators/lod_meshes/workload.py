"""What Make LOD Meshes has done and has yet to do, weighed by the time that it takes."""

from collections.abc import Generator
from dataclasses import dataclass

from ...crowd_lod.progress import Made, share

READ = 0.07  # progress at which all characters are read
# How many times as long as reading a character each work on one of its LODs takes.
SEARCH = 10.0  # finding the LOD of a length
MAKE = 2.0  # making the LOD of a ratio, and measuring it
LOOK = 0.35  # looking at the LOD of a ratio between the poses
FURTHER = 0.3  # searches that the result of a search calls for, on average


@dataclass
class Workload:
    """Work in parts, whose number becomes known on the way.

    done, left: what the parts cost, in times of reading some character. When `left` grows the
    progress goes back, so that the time left stays true.
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
        return READ + (1 - READ) * done / max(self.done + self.left, done, 1e-9)
