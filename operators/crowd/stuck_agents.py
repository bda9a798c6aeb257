"""Agents that chatter or get stuck, found ahead of time at a bounded cost."""

from dataclasses import dataclass, fields, replace

import numpy as np

from ...crowd_lod.behaviour.courant_number import courant
from ...crowd_lod.behaviour.exact_walk import Trouble, trouble
from ...crowd_lod.behaviour.trajectory import Trajectory

SECONDS = 60.0  # how far ahead is looked
MOST_AGENTS = 200_000
# Reads of the table, and so the time, about two seconds; borders that one agent may cross.
MOST_READS, MOST_BORDERS = 4_000_000, 4_000


@dataclass(frozen=True)
class Troubles:
    """What was found.

    found: a Trouble for each kind.
    agents: how many agents were checked, the first ones of the crowd.
    count: all agents of the crowd.
    seconds: how far ahead of the first frame was checked.
    """

    found: tuple[Trouble, ...]
    agents: int
    count: int
    seconds: float

    @property
    def sentence(self) -> str:
        """Return all of it as text for the user, "" if all is well and was checked."""
        parts = [str(each) for each in self.found]
        if self.agents < self.count or self.seconds < SECONDS:
            parts.append(
                f"Only the first {self.agents:,} of {self.count:,} agents were checked for chattering or being stuck, {self.seconds:.3g} s ahead."
            )
        return " ".join(parts)

    @property
    def rows(self) -> list[dict]:
        """Return a dict for plan.json per kind, with the place where most agents have it."""
        return [
            {
                "kind": each.kind,
                "agents": len(each.agents),
                "place": [float(each.x[0]), float(each.y[0])],
                "column": int(each.column[0]),
                "row": int(each.row[0]),
                "count": int(each.counts[0]),
            }
            for each in self.found
        ]


def find(trajectory: Trajectory) -> Troubles:
    """Find the crowd's troubles from its first frame on.

    It looks a minute ahead, but not beyond MOST_BORDERS cells of the fastest agent. It checks all
    agents, but at most MOST_AGENTS and what MOST_READS allow. Agents are placed at random, so the
    first ones are a fair sample.
    """
    crowd, machine, world = trajectory.start, trajectory.machine, trajectory.world
    borders = max(float(courant(machine, world, 1.0).max()), 1 / SECONDS)
    seconds = min(SECONDS, MOST_BORDERS / borders)
    count = min(len(crowd), MOST_AGENTS, max(1, int(MOST_READS / (borders * seconds))))
    if count < len(crowd):
        crowd = replace(crowd, **{each.name: np.ascontiguousarray(getattr(crowd, each.name)[:count]) for each in fields(crowd)})
    return Troubles(trouble(crowd, machine, world, seconds), count, len(trajectory.start), seconds)
