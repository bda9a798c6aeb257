"""Where the people of a simulation start and where they go to, on each part of the ground."""

import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from math import sqrt
from typing import Any

import numpy as np

from ....crowd_lod.errors import CrowdError

# meters between two people at the start, and from a person to a wall
APART = 0.45
OFF_WALL = 0.25
INTO_GOAL = (
    0.3,
    0.1,
    0.02,
)  # meters from a goal's edge to where people aim at, of a narrow one less
MOST_DOORS = 2000  # places that people come in at, about
TRIES = 20  # places that are tried for each person who comes in, before it waits


def lacking() -> str:
    """Return a sentence on why people cannot be simulated in this Python; "" where they can."""
    if all(find_spec(name) is not None for name in ("jupedsim", "shapely")):
        return ""
    if sys.platform == "linux" and platform.machine() == "aarch64":
        return (
            "JuPedSim, which simulates, does not exist for Linux on ARM: simulate on another "
            "machine, and open the file here"
        )
    return (
        f"This Blender's Python {sys.version_info[0]}.{sys.version_info[1]} lacks JuPedSim, which "
        f"simulates: install the extension from the zip for this machine"
    )


def load(name: str) -> Any:
    """Return the module `name`; CrowdError where it is missing."""
    if said := lacking():
        raise CrowdError(f"{said}.")
    return import_module(name)


@dataclass(frozen=True)
class Goal:
    """Where people walk to.

    area: Polygons, meters from the origin.
    share: of the people who draw their goal.
    is_exit: whether they leave there; else they stay.
    """

    area: Any
    share: float = 1.0
    is_exit: bool = True


@dataclass(frozen=True)
class People:
    """The people of one crowd.

    name: of the crowd, for messages.
    starts: Polygons to start in, or places (k, 2) float64; meters from the origin.
    goals: where they walk to.
    nearest: whether each walks to the nearest goal; else they draw one by the shares.
    speeds: (n,) float64 m/s, of each when nobody is in its way.
    per_minute: how many come a minute; 0 if all are there at first.
    seed: of all draws.
    """

    name: str
    starts: Any
    goals: Sequence[Goal]
    nearest: bool
    speeds: np.ndarray
    per_minute: float = 0.0
    seed: int = 0


class Site:
    """The starts and goals of one crowd.

    count: of its people; those who find no place of their own to start at are left out.
    speeds: (count,) m/s. due: (count,) seconds, when each comes.
    parts: the numbers of those that people may start on.
    aims_of: for each part of the ground and each goal the Aim, None where the goal is elsewhere.
    """

    def __init__(self, crowd: People, ground: Sequence[Any]):
        shapely = load("shapely")
        draws = np.random.default_rng(crowd.seed)
        self._crowd = crowd
        self._draws = draws
        self.aims_of = [[aim_in(goal, part, draws) for goal in crowd.goals] for part in ground]
        # where people may start on each part, (part, Polygons)
        self._floors = [
            (p, part.buffer(-OFF_WALL)) for p, part in enumerate(ground) if any(self.aims_of[p])
        ]
        self._points = None
        if isinstance(crowd.starts, np.ndarray):
            inside = self._part_of(crowd.starts) >= 0
            points = draws.permutation(crowd.starts[inside])
            self._points = points[apart_of(points)]
            anywhere = len(self._points) > 0
        else:
            self._floors = [(p, crowd.starts.intersection(floor)) for p, floor in self._floors]
            self._floors = [(p, floor) for p, floor in self._floors if floor.area > 0]
            anywhere = bool(self._floors)
        if not anywhere:
            raise CrowdError(
                f"{crowd.name} has no ground with both a place to spawn and a goal: choose "
                f"goals that people can reach from where they spawn, or spawn elsewhere."
            )
        self._area = shapely.union_all([floor for _, floor in self._floors])
        self.parts = [p for p, _ in self._floors]
        self.count = len(crowd.speeds)
        if crowd.per_minute:
            self._doors = self._points
            if self._doors is None:
                self._doors = self._grid(max(sqrt(self._area.area / MOST_DOORS), APART))
        elif self._points is not None:
            self.count = min(self.count, len(self._points))
        self.speeds = crowd.speeds[: self.count]
        self.due = np.zeros(self.count)
        if crowd.per_minute:
            self.due = (np.arange(self.count) + draws.random(self.count)) * 60 / crowd.per_minute
            self.due[:1] = 0

    def rooms(
        self, wanted: int, taken: np.ndarray, at_first: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return places (k, 2) for at most the `wanted` people who are due, and the part of each.

        taken: (m, 2), where others are.
        CrowdError if a crowd finds no room at first.
        """
        if not self._crowd.per_minute:
            places = self._own_places(wanted, taken)
        else:
            doors = self._draws.permutation(self._doors)
            doors = doors if at_first else doors[: TRIES * wanted]
            doors = doors[is_free(doors, taken)]
            places = doors[apart_of(doors)][:wanted]
            if at_first and not len(places):
                raise CrowdError(self._no_room(0))
        return places, self._part_of(places)

    def aims(self, places: np.ndarray, part_of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the goal (m,) of who starts at each of `places` (m, 2), and where in it, (m, 2)."""
        goals = np.zeros(len(places), np.intp)
        targets = np.zeros((len(places), 2))
        for part in np.unique(part_of):
            (people,) = np.nonzero(part_of == part)
            aims = {g: aim for g, aim in enumerate(self.aims_of[part]) if aim is not None}
            numbers = np.array([*aims])
            if self._crowd.nearest:
                far = [aim.distance(places[people]) for aim in aims.values()]
                goals[people] = numbers[np.argmin(far, axis=0)]
            else:
                shares = np.array([self._crowd.goals[g].share for g in numbers])
                shares = shares / shares.sum() if shares.any() else None
                goals[people] = self._draws.choice(numbers, len(people), p=shares)
            for g, aim in aims.items():
                own = people[goals[people] == g]
                targets[own] = aim.targets(places[own])
        return goals, targets

    def _part_of(self, places: np.ndarray) -> np.ndarray:
        """Return on which part each of the places (m, 2) lies, (m,) intp; -1 on none."""
        shapely = load("shapely")
        part_of = np.full(len(places), -1)
        for p, floor in self._floors:
            part_of[shapely.contains_xy(floor, *places.T)] = p
        return part_of

    def _own_places(self, count: int, taken: np.ndarray) -> np.ndarray:
        """Return places (count, 2) that are free, APART from each other; of points, at most so many.

        They are those of a grid, jittered. CrowdError if so many do not fit.
        """
        if self._points is not None:
            return self._points[is_free(self._points, taken)][:count]
        between = max(sqrt(self._area.area / max(count, 1)), APART)
        while True:
            places = self._grid(between)
            places = places[is_free(places, taken)]
            if len(places) >= count:
                # in the order of the grid: JuPedSim takes a third longer for a shuffled crowd
                return places[np.sort(self._draws.permutation(len(places))[:count])]
            if between == APART:
                raise CrowdError(self._no_room(len(places)))
            between = max(0.9 * between, APART)

    def _grid(self, between: float) -> np.ndarray:
        """Return places (k, 2) of a grid over the starts, jittered, APART from each other."""
        shapely = load("shapely")
        return jittered_grid(shapely, self._area, between, self._draws)

    def _no_room(self, found: int) -> str:
        return (
            f"{self._crowd.name} has {len(self._crowd.speeds):,} agents, and only {found:,} find "
            f"room to spawn {APART} m apart: lower Agents, or give it more ground to spawn on."
        )


@dataclass
class Aim:
    """A goal on one part of the ground.

    area: Polygons, where one has arrived. within: the same without its rim, where people aim at.
    spots: places (k, 2) to stay at; None for an exit. taken: how many of them are given away.
    """

    area: Any
    within: Any
    spots: np.ndarray | None
    taken: int = 0

    def holds(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return which places (m,) lie in it, (m,) bool."""
        return load("shapely").contains_xy(self.area, x, y)

    def distance(self, places: np.ndarray) -> np.ndarray:
        """Return how far it is from the places (m, 2), (m,) meters."""
        shapely = load("shapely")
        return shapely.distance(shapely.points(places), self.area)

    def targets(self, places: np.ndarray) -> np.ndarray:
        """Return where those walk to who start at `places` (m, 2), (m, 2): the nearest place of an
        exit, each its own of another goal.
        """
        if self.spots is None:
            shapely = load("shapely")
            lines = shapely.shortest_line(self.within, shapely.points(places))
            return shapely.get_coordinates(lines).reshape(-1, 2, 2)[:, 0]
        numbers = (self.taken + np.arange(len(places))) % len(self.spots)
        self.taken += len(places)
        return self.spots[numbers]


def aim_in(goal: Goal, part: Any, draws: np.random.Generator) -> Aim | None:
    """Return the goal on one part of the ground; None where it is not on it."""
    shapely = load("shapely")
    area = goal.area.intersection(part)
    within = (area.buffer(-rim) for rim in INTO_GOAL)
    within = next((each for each in within if not each.is_empty), None)
    if within is None:
        return None
    if goal.is_exit:
        return Aim(area, within, None)
    spots = draws.permutation(jittered_grid(shapely, within, 1.5 * APART, draws))
    if not len(spots):
        spots = shapely.get_coordinates(within.representative_point())
    return Aim(area, within, spots)


def jittered_grid(
    shapely: Any, area: Any, between: float, draws: np.random.Generator
) -> np.ndarray:
    """Return places (k, 2) in `area`, `between` meters from each other, moved to APART at least."""
    shapely.prepare(area)
    low, high = np.reshape(area.bounds, (2, 2))
    axes = [np.arange(a, b + between, between) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    turn = 2 * np.pi * draws.random(len(places))
    far = (between - APART) / 2 * np.sqrt(draws.random(len(places)))
    places = places + np.stack([far * np.cos(turn), far * np.sin(turn)], axis=1)
    return places[shapely.contains_xy(area, *places.T)]


def is_free(places: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return which places (m, 2) are APART from those that are taken (k, 2), (m,) bool."""
    shapely = load("shapely")
    tree = shapely.STRtree(shapely.points(taken))
    near, _ = tree.query(shapely.points(places), predicate="dwithin", distance=APART)
    free = np.ones(len(places), bool)
    free[near] = False
    return free


def apart_of(places: np.ndarray) -> np.ndarray:
    """Return which places (m, 2) remain, (m,) bool, without those near to one before them."""
    shapely = load("shapely")
    points = shapely.points(places)
    pairs = shapely.STRtree(points).query(points, predicate="dwithin", distance=APART)
    first, second = pairs[:, pairs[0] < pairs[1]]
    remains = np.ones(len(places), bool)
    for a, b in sorted(zip(first.tolist(), second.tolist(), strict=True)):
        remains[b] &= not remains[a]
    return remains
