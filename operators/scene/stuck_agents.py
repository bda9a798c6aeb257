"""Agents that chatter or get stuck, found ahead of time, and off-color pixels of the map.

The search has a bounded cost.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...crowd_lod.behavior.exact_walk import Trouble, trouble
from ...crowd_lod.behavior.step import courant
from ...crowd_lod.behavior.walk import Walk, walks_of
from ...crowd_lod.crowd.state_machine import StateMachine
from ...crowd_lod.messages import Message, MessageKind
from ...crowd_lod.sources.trajectory import Trajectory
from ...crowd_lod.world.maps import LabelMap
from ..settings.messages import in_words

SECONDS = 60.0  # that the search looks ahead
MOST_AGENTS = 200_000
MOST_READS = 4_000_000  # of the machine's table: about two seconds
MOST_BORDERS = 4_000  # of cells that one agent may cross


@dataclass(frozen=True)
class OffColor(Trouble):
    """Pixels of the label map that are of no label's color, LabelMap.strays: nobody's trouble.

    label: the map's first, which these pixels have instead.
    """

    label: str = ""

    @property
    def message(self) -> Message:
        facts = {
            "pixels": int(self.counts[0]),
            "label": self.label,
            "column": int(self.column[0]),
            "row": int(self.row[0]),
        }
        return Message(MessageKind.OFF_COLOR, facts=facts)


def off_color(world: LabelMap, machine: StateMachine) -> tuple[OffColor, ...]:
    """Return the OffColor of the map, () if it has no such pixels."""
    row, column = world.strays.T
    if not len(row):
        return ()
    x, y = world.middles(row, column)
    nobody = np.empty(0, np.intp)
    counts = np.array([len(row)])
    return (OffColor("off-color", nobody, x, y, column, row, counts, machine.labels[0]),)


@dataclass(frozen=True)
class Troubles:
    """What was found.

    troubles: a Trouble for each kind; first an OffColor if the map has such pixels.
    agents: how many agents were checked, the first ones of the crowd.
    count: all agents of the crowd.
    seconds: how far ahead of the first frame was checked.
    """

    troubles: tuple[Trouble, ...]
    agents: int
    count: int
    seconds: float

    @property
    def messages(self) -> list[Message]:
        """Return all of it as messages, none if all is well and was checked."""
        messages = [each.message for each in self.troubles]
        if self.agents < self.count or self.seconds < SECONDS:
            facts = {"checked": self.agents, "agents": self.count, "seconds": self.seconds}
            messages.append(Message(MessageKind.CHECKED_IN_PART, facts=facts))
        return messages

    @property
    def sentence(self) -> str:
        """Return all of it as text for plan.json."""
        return " ".join(line.sentence for line in in_words(self.messages))

    @property
    def rows(self) -> list[dict]:
        """Return a dict for plan.json per kind, with the place where most agents have it."""
        return [
            {
                "kind": trouble.kind,
                "agents": len(trouble.agents),
                "place": [float(trouble.x[0]), float(trouble.y[0])],
                "column": int(trouble.column[0]),
                "row": int(trouble.row[0]),
                "count": int(trouble.counts[0]),
            }
            for trouble in self.troubles
        ]


def find(trajectory: Trajectory, meters: float = 1.0) -> Troubles:
    """Find the troubles of agents that a state machine moves, from the first frame on.

    It looks a minute ahead, but not beyond MOST_BORDERS cells of the fastest agent. It checks all
    agents, but at most MOST_AGENTS and what MOST_READS allow. Agents are placed at random, so the
    first ones are a fair sample.

    meters: in a unit of the scene. Places of what is found are in meters.
    """
    parts = [_of_walk(walk) for walk in walks_of(trajectory)]
    findings = tuple(
        replace(each, x=each.x * meters, y=each.y * meters)
        for part in parts
        for each in part.troubles
    )
    agents, count = (sum(getattr(part, name) for part in parts) for name in ("agents", "count"))
    return Troubles(findings, agents, count, min((part.seconds for part in parts), default=SECONDS))


def _of_walk(walk: Walk) -> Troubles:
    crowd = walk.start
    machine = walk.machine
    world = walk.world
    borders = max(float(courant(machine, world, 1.0).max()), 1 / SECONDS)
    seconds = min(SECONDS, MOST_BORDERS / borders)
    count = min(len(crowd), MOST_AGENTS, max(1, int(MOST_READS / (borders * seconds))))
    if count < len(crowd):
        crowd = replace(
            crowd,
            **{
                name: np.ascontiguousarray(column[:count]) for name, column in crowd.columns.items()
            },
        )
    found = *off_color(world, machine), *trouble(crowd, machine, world, seconds)
    return Troubles(found, count, len(walk.start), seconds)
