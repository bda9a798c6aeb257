"""People who walk to goals, around walls and each other, by JuPedSim (https://www.jupedsim.org).

All crowds of a scene walk in one run. JuPedSim and Shapely are imported when it begins.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import chain
from math import ceil
from typing import Any

import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.tracks.rows import Rows
from ....crowd_lod.tracks.simulated import Facing, nearest_distance
from .simulation_sites import People, Site, load

# meters and seconds. With JuPedSim's own gap of 1 s dense streams that cross jam: after 50 s 46 of
# 120 people are through, of whom all are with 0.5 s. A door then lets 1.7 people a meter and second
# through, for 1.3. Its anticipation velocity model jams for good before doors.
RADIUS = 0.2
TIME_GAP = 0.5
STEP = 0.05
EVERY = 2  # steps from one row of the file to the next
RATE = 1 / (STEP * EVERY)  # rows a second
# Rows from one look at who has arrived to the next: each takes as long as a row, as agents are asked
# for anew when someone leaves.
LOOKS = 5
# meters: from its place in a goal, where a person stops; and of a person's way between two looks,
# who is in the goal and held up by others
REACHED = 0.4
HELD_UP = 0.05
# What placing the people costs, and putting their rows together, as parts of the run.
PLACING, JOINING = 0.05, 0.1


@dataclass(frozen=True)
class Walked:
    """How one crowd has walked.

    rows: meters from the origin; ids count the people from 0.
    came, left, stayed: how many there were, have left at an exit, and stand at a goal.
    at_first: how many were there from the first row on.
    """

    rows: Rows
    came: int
    left: int
    stayed: int
    at_first: int


def simulate(
    ground: Any, crowds: Sequence[People], seconds: float
) -> Generator[float, None, tuple[list[Walked], float]]:
    """Let the people walk: yield the progress, 0 to 1.

    Returns how each crowd has walked, and the least distance between any two people in any row,
    meters.

    ground: Polygons that may be walked on, meters from the origin. Nobody gets from one to another.
    CrowdError if JuPedSim is not there, or cannot simulate it.
    """
    jupedsim = load("jupedsim")
    shapely = load("shapely")
    rows = ceil(seconds * RATE)
    work = Workload((1 + PLACING + JOINING) * rows)
    try:
        run = _Simulation(jupedsim, [*shapely.get_parts(ground)], crowds)
        for row in range(rows):
            run.let_in(row)
            run.record(row)
            yield work.did(1 + PLACING * rows if row == 0 else 1)
            if row % LOOKS == 0:
                run.arrive()
            run.walk()
        run.record(rows)
    except RuntimeError as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        raise CrowdError(f"JuPedSim cannot simulate these crowds: {reason}.") from None
    return (yield from work.take(run_in_thread(run.walked), JOINING * rows))


WAITS, WALKS, STAYS, LEFT = range(4)  # what a person does; who waits has not come yet


class _Simulation:
    """One simulation: all people of all crowds, numbered through, and where they are."""

    def __init__(self, jupedsim: Any, ground: list[Any], crowds: Sequence[People]):
        self.crowds = crowds
        self.sites = [Site(crowd, ground) for crowd in crowds]
        used = sorted({part for site in self.sites for part in site.parts})
        self.parts = {part: _WalkedPart(jupedsim, ground[part]) for part in used}
        counts = [site.count for site in self.sites]
        self.first = np.cumsum([0, *counts])
        total = int(self.first[-1])
        self.speeds = np.concatenate([np.empty(0), *(site.speeds for site in self.sites)])
        self.due = np.concatenate([np.empty(0), *(site.due for site in self.sites)])
        self.does = np.full(total, WAITS)
        self.goal = np.zeros(total, np.intp)
        self.target = np.zeros((total, 2))
        self.place = np.zeros((total, 2))
        self.looked = np.full((total, 2), np.nan)  # where they were at the last look
        self.facing = Facing(np.zeros(total))
        self.kept: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = []

    def let_in(self, row: int) -> None:
        """Let those in whose time has come, where there is room."""
        for k, site in enumerate(self.sites):
            begin, end = self.first[k : k + 2]
            due = begin + np.flatnonzero(
                (self.does[begin:end] == WAITS) & (self.due[begin:end] <= row / RATE)
            )
            if not len(due):
                continue
            there = (self.does == WALKS) | (self.does == STAYS)
            places, part_of = site.rooms(len(due), self.place[there], row == 0)
            people = due[: len(places)]
            goals, targets = site.aims(places, part_of)
            self.does[people] = WALKS
            self.place[people] = places
            self.goal[people] = goals
            self.target[people] = targets
            way = targets - places
            self.facing.heading[people] = np.arctan2(way[:, 1], way[:, 0])
            for person, part in zip(people.tolist(), part_of.tolist(), strict=True):
                self.parts[part].add(
                    person, self.place[person], self.target[person], self.speeds[person]
                )
        for each in self.parts.values():
            each.look()

    def record(self, row: int) -> None:
        """Keep where everyone is."""
        people = np.flatnonzero((self.does == WALKS) | (self.does == STAYS))
        self.kept.append((row, people, self.place[people], self.facing.heading[people]))

    def arrive(self) -> None:
        """Let those leave who are at an exit, and those stop who are at their place in a goal, or
        in it and can't get further.
        """
        for p, part in self.parts.items():
            people = part.people
            if not len(people):
                continue
            crowd_of = np.searchsorted(self.first, people, side="right") - 1
            places = self.place[people]
            near = np.hypot(*(places - self.target[people]).T) < REACHED
            held_up = np.hypot(*(places - self.looked[people]).T) < HELD_UP
            self.looked[people] = places
            leaves = np.zeros(len(people), bool)
            stops = np.zeros(len(people), bool)
            for k, site in enumerate(self.sites):
                for g, goal in enumerate(self.crowds[k].goals):
                    (own,) = np.nonzero((crowd_of == k) & (self.goal[people] == g))
                    if not len(own):
                        continue
                    inside = site.aims_of[p][g].holds(*places[own].T)
                    if goal.is_exit:
                        leaves[own] = inside
                    else:
                        walks = self.does[people[own]] == WALKS
                        stops[own] = walks & (near[own] | held_up[own] & inside)
            self.does[people[stops]] = STAYS
            self.does[people[leaves]] = LEFT
            part.end(leaves, stops)

    def walk(self) -> None:
        """Walk on to the next row."""
        for part in self.parts.values():
            part.walk()
            people = part.people
            places = part.places()
            self.facing.follow(people, places - self.place[people], 1 / RATE)
            self.place[people] = places

    def walked(self) -> tuple[list[Walked], float]:
        """Return how each crowd has walked, and the least distance between any two people."""
        frames = np.repeat([row for row, *_ in self.kept], [len(who) for _, who, *_ in self.kept])
        people, places, headings = (
            np.concatenate([kept[k] for kept in self.kept]) for k in (1, 2, 3)
        )
        outcomes = []
        for begin, end in zip(self.first[:-1], self.first[1:], strict=True):
            (own,) = np.nonzero((people >= begin) & (people < end))
            rows = Rows(
                id=(people[own] - begin).astype(np.int32),
                frame=frames[own].astype(np.int32),
                x=places[own, 0],
                y=places[own, 1],
                heading=headings[own].astype(np.float32),
                rate=RATE,
                until=float(self.kept[-1][0]),
            )
            does = self.does[begin:end]
            outcomes.append(
                Walked(
                    rows,
                    int((does != WAITS).sum()),
                    int((does == LEFT).sum()),
                    int((does == STAYS).sum()),
                    int((rows.frame == 0).sum()),
                )
            )
        return outcomes, nearest_distance(frames, places)


class _WalkedPart:
    """A part of the ground that hangs together, and who is on it.

    people: (m,) intp, their numbers.
    """

    def __init__(self, jupedsim: Any, ground: Any):
        self._jupedsim = jupedsim
        self._simulation = jupedsim.Simulation(
            model=jupedsim.CollisionFreeSpeedModel(), geometry=ground, dt=STEP
        )
        self._stage = self._simulation.add_direct_steering_stage()
        self._journey = self._simulation.add_journey(jupedsim.JourneyDescription([self._stage]))
        self._numbers: dict[int, int] = {}  # by JuPedSim's own
        # Asked for once, which halves the time of a row: they hold until someone comes or leaves.
        self._agents: list[Any] = []
        self._is_known = True
        self.people = np.empty(0, np.intp)

    def add(self, person: int, place: np.ndarray, target: np.ndarray, speed: float) -> None:
        """Let a person in. Call `look` after the last."""
        parameters = self._jupedsim.CollisionFreeSpeedModelAgentParameters(
            position=tuple(place.tolist()),
            desired_speed=float(speed),
            radius=RADIUS,
            time_gap=TIME_GAP,
            journey_id=self._journey,
            stage_id=self._stage,
        )
        agent = self._simulation.add_agent(parameters)
        self._simulation.agent(agent).target = tuple(target.tolist())
        self._numbers[agent] = person
        self._is_known = False

    def end(self, leaves: np.ndarray, stops: np.ndarray) -> None:
        """Let those stand who stop, and take those out who leave, at the next step.

        leaves, stops: (m,) bool, of `people`.
        """
        for k in np.flatnonzero(stops).tolist():
            self._agents[k].model.desired_speed = 0.0
        for k in np.flatnonzero(leaves).tolist():
            self._simulation.mark_agent_for_removal(self._agents[k].id)
            self._is_known = False

    def walk(self) -> None:
        """Walk on to the next row."""
        self._simulation.iterate(EVERY)
        self.look()

    def look(self) -> None:
        """See who is there."""
        if not self._is_known:
            self._agents = [*self._simulation.agents()]
            self.people = np.array([self._numbers[agent.id] for agent in self._agents], np.intp)
            self._is_known = True

    def places(self) -> np.ndarray:
        """Return where the people are, (m, 2) float64 meters."""
        places = chain.from_iterable(agent.position for agent in self._agents)
        return np.fromiter(places, float, 2 * len(self._agents)).reshape(-1, 2)
