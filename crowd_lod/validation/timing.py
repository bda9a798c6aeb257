"""Times that can be trusted: ways run in turn until their medians are steady."""

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

FEWEST, MOST = 5, 25  # runs of a way
STEADY = 0.1  # of a median: by so much it may be off when the runs end
LONGEST = 20.0  # seconds that all runs of all ways may take, the fewest aside
MEDIAN = 1.25 / 1.35  # of the quartiles' distance, by root of the runs: the median's own spread

Key = TypeVar("Key")  # what tells a way


@dataclass
class Times:
    """What each run of a way took, milliseconds: of the clock, and of all processors."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def row(self, parts: float = 1.0) -> dict[str, float | int]:
        """Return columns of a table: medians, least and most, runs, whether the median is steady.

        parts: of a run, of which one is told.
        """
        return {
            "cpu_ms": float(np.median(self.cpu)) / parts,
            "wall_ms": float(np.median(self.wall)) / parts,
            "wall_ms_least": min(self.wall) / parts,
            "wall_ms_most": max(self.wall) / parts,
            "runs": len(self.wall),
            "steady": int(self.is_steady),
        }

    @property
    def is_steady(self) -> bool:
        """Whether the median is known to a tenth, by the quartiles of the runs."""
        low, middle, high = np.quantile(self.wall, (0.25, 0.5, 0.75))
        enough = len(self.wall) >= FEWEST
        return enough and bool(MEDIAN * (high - low) / len(self.wall) ** 0.5 <= STEADY * middle)


def time_in_turn(
    ways: Mapping[Key, Callable[[], object]], fewest: int = FEWEST
) -> dict[Key, Times]:
    """Return what runs of each way took, after one run of each that does not count.

    The ways take turns, so that what slows the machine for a while slows all of them.

    fewest: runs of each way, at least; more follow until all are steady. Fewer than FEWEST are all.
    """
    taken = {name: Times() for name in ways}
    for run in ways.values():
        run()
    begun = clock.perf_counter()
    for turn in range(MOST):
        late = fewest < FEWEST or clock.perf_counter() > begun + LONGEST
        if turn >= fewest and (late or all(times.is_steady for times in taken.values())):
            break
        for name, run in ways.items():
            wall, cpu = clock.perf_counter(), clock.process_time()
            run()
            taken[name].cpu.append(1000 * (clock.process_time() - cpu))
            taken[name].wall.append(1000 * (clock.perf_counter() - wall))
    return taken
