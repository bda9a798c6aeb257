"""The crowd: one array a column, and its first frame (chapter section 1.2, "Populating")."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..errors import CrowdError
from . import morton_order, random_streams
from .maps import LabelMap
from .state_machine import StateMachine

MOST_AGENTS = 10_000_000
MOST_GROUPS = 255
# Agents of a crowd that lies in memory as it stands: a smaller one fits in the processor's cache in any order.
IN_PLACE = 40_000
UNSET: Any = None  # a column that Crowd is to fill itself
CLASSES = 16  # phases of their action that agents share, see animation/phase_classes.py


@dataclass(frozen=True)
class Group:
    """A character group (geometrical variety).

    centre, radius: the bounding sphere over the whole action, metres: its centre stands on the agent's vertical axis
    at the height `centre` above the feet, so that it holds for every heading. stride: metres walked in one cycle of
    the action, 0 if the action plays by time. period: seconds in one cycle. vertices, triangles: of each LOD mesh,
    finest first; a group with fewer LODs than others repeats its last. lowest: metres from the group's origin up to its
    lowest point over the action, 0 if near; on_ground: whether that point is its feet, and not its origin.

    Measured over the action, if the LOD meshes were: deviations: metres, of each LOD, the largest distance found of its
    surface from the character's, both ways; bounds: metres, what the Hausdorff distance is at most, the deviations where
    nothing else is known; rms: metres, the root mean square of the distances; worst: the frame at which each deviates most;
    diagonal: metres, of the character's bounding box; shaded: of each LOD the metres that a pixel shows from which on its shaded
    picture is within shading.WITHIN of the character's, 0 for any, inf where none is; () while pictures were not compared.
    """

    name: str
    centre: float
    radius: float
    stride: float
    period: float
    vertices: tuple[int, ...] = ()
    triangles: tuple[int, ...] = ()
    deviations: tuple[float, ...] = ()
    bounds: tuple[float, ...] = ()
    rms: tuple[float, ...] = ()
    worst: tuple[float, ...] = ()
    diagonal: float = 0.0
    shaded: tuple[float, ...] = ()
    lowest: float = 0.0
    on_ground: bool = False

    @property
    def reach(self) -> float:
        """Metres, the radius of the sphere that holds the LODs as well, which lie off the character by their bounds at most."""
        return self.radius + max(self.bounds, default=0.0)

    @property
    def feet(self) -> float:
        """Metres from the group's origin up to what stands on the ground."""
        return self.lowest if self.on_ground else 0.0

    def __post_init__(self) -> None:
        if len(self.bounds) != len(self.deviations):
            object.__setattr__(self, "bounds", self.deviations)


@dataclass(frozen=True)
class Spheres:
    """The groups' bounding spheres: centre, radius, reach, as of Group, (G,) float64 metres each."""

    centre: np.ndarray
    radius: np.ndarray
    reach: np.ndarray


def spheres_of(groups: Sequence[Group]) -> Spheres:
    """The bounding spheres of the `groups`."""
    return Spheres(*(np.array([getattr(group, each.name) for group in groups], np.float64) for each in fields(Spheres)))


@dataclass(frozen=True)
class Crowd:
    """n agents at one time, world space.

    x, y, z: (n,) float64, the feet, metres. heading: (n,) float32, radians from +x, counter-clockwise seen from above.
    state, group: (n,) uint8. phase_class: (n,) uint8, which of the shared phases of the action it plays, see animation/phase_classes.py.
    wait: (n,) float64, seconds until the state's timer ends the state, inf without one. key: (n,) uint64, what the
    agent's random draws hash (crowd/random_streams.py). mirror: (n,) uint8, whether the map's edge has reflected the agent's way in
    x (1) and y (2). pace: (n,) uint8, which of the machine's paces it walks at. 49 bytes an agent in all. The last four may
    be left out: no timer runs, seed 0, not reflected, the first pace.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    heading: np.ndarray
    state: np.ndarray
    group: np.ndarray
    phase_class: np.ndarray
    wait: np.ndarray = UNSET
    key: np.ndarray = UNSET
    mirror: np.ndarray = UNSET
    pace: np.ndarray = UNSET

    def __post_init__(self) -> None:
        n = len(self.x)
        if self.wait is None:
            object.__setattr__(self, "wait", np.full(n, np.inf))
        if self.key is None:
            object.__setattr__(self, "key", random_streams.keys(0, n))
        if self.mirror is None:
            object.__setattr__(self, "mirror", np.zeros(n, np.uint8))
        if self.pace is None:
            object.__setattr__(self, "pace", np.zeros(n, np.uint8))

    def __len__(self) -> int:
        return len(self.x)

    def of(self, agents: np.ndarray | slice) -> "Crowd":
        """These agents alone."""
        return Crowd(**{name: column[agents] for name, column in vars(self).items()})

    def places(
        self,
        height: np.ndarray | None = None,
        agents: np.ndarray | slice | int = slice(None),
        origin: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, y, z, (m,) float64 metres each: where `agents` stand, from `origin` (3,); each above its feet by its group's `height`
        (G,), such as Spheres.centre. Not to be written to: they may be the crowd's own."""
        z = self.z[agents] if height is None else self.z[agents] + height[self.group[agents]]
        found = self.x[agents], self.y[agents], z
        return found if origin is None else tuple(place - start for place, start in zip(found, origin, strict=True))


def runs(group: np.ndarray) -> list[tuple[int, int]]:
    """[(begin, end)] of the agents, group (n,), that follow one another in one group."""
    edges = [0, *(np.flatnonzero(group[1:] != group[:-1]) + 1).tolist(), len(group)]
    return list(zip(edges[:-1], edges[1:], strict=True))


def bounding_sphere(points: np.ndarray, reach: np.ndarray | float = 0.0) -> tuple[float, float]:
    """(centre, radius) of the smallest sphere on the z axis, up to the centre's choice at half height, that holds the
    points (n, 3), metres, and all within `reach`, metres, (n,) or one, of each: it holds them under every rotation about z."""
    low, high = (points[:, 2] - reach).min(), (points[:, 2] + reach).max()
    centre = (low + high) / 2
    away = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + (points[:, 2] - centre) ** 2)
    return float(centre), float((away + reach).max())


def populate(count: int, seed: int, groups: int, machine: StateMachine, world: LabelMap, classes: int = CLASSES) -> Crowd:
    """The crowd's first frame: `count` agents at random on the labels where `machine` lets them start.

    The same arguments give the same crowd, bit for bit. State follows the machine's start weights; the group, of
    `groups`, and the phase, of `classes`, are uniform; the heading is that of the first move, uniform for those who stand. Agents of
    one group follow one another, so that the culling need not look up each one's sphere (see `runs`).
    """
    if not 1 <= count <= MOST_AGENTS:
        raise CrowdError(f"The crowd has {count} agents; set a count from 1 to {MOST_AGENTS}.")
    if not 1 <= groups <= MOST_GROUPS:
        raise CrowdError(f"The crowd has {groups} character groups; give it 1 to {MOST_GROUPS}.")
    open_cells = np.flatnonzero(machine.spawn[world.labels])
    if not len(open_cells):
        raise CrowdError("The map has no place where agents may start: paint a label whose spawn is true.")
    random = np.random.Generator(np.random.PCG64(seed))
    cell = open_cells[random.integers(len(open_cells), size=count)]
    row, column = np.divmod(cell, world.labels.shape[1])
    x = world.area.x_min + (column + random.random(count)) * world.cell[0]
    y = world.area.y_min + (row + random.random(count)) * world.cell[1]
    state = np.searchsorted(np.cumsum(machine.start)[:-1], random.random(count), side="right").astype(np.uint8)
    group = np.sort(random.integers(groups, size=count, dtype=np.uint8))
    phase = (random.random(count, dtype=np.float32) * np.float32(classes)).astype(np.uint8)
    label = world.at(x, y)
    first_move, pace = machine.velocity[state, label], machine.paces.of[state, label]
    heading = np.where(
        first_move.any(axis=1),
        np.arctan2(first_move[:, 1], first_move[:, 0]),
        random.uniform(-np.pi, np.pi, count),
    ).astype(np.float32)
    if count >= IN_PLACE:
        order = morton_order.order_of(x, y, group, world.area)
        x, y, heading, state, group, phase, pace = (each[order] for each in (x, y, heading, state, group, phase, pace))
    key = random_streams.keys(seed, count)
    return Crowd(x, y, np.full(count, world.area.z), heading, state, group, phase, machine.waits(state, key), key, pace=pace)
