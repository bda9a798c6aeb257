"""The crowd, one array per column (chapter section 1.2)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import CrowdError
from . import random_streams
from .paces import mixed_in
from .strides import Plays

MOST_AGENTS = 10_000_000
MOST_GROUPS = 255
# Agents of a crowd that lies in memory as it stands: a smaller one fits in the processor's cache in
# any order.
IN_PLACE = 40_000
UNSET: Any = None  # a column that Crowd is to fill itself
CLASSES = 16  # phases of their action that agents share, see animation/phase_classes.py
FEWEST_CLASSES = 3  # of these, in a plan's smallest palette


@dataclass(frozen=True)
class Draw:
    """How agents are drawn from character groups.

    weights: of the groups, in proportion; or their number, if all are as likely.
    indices: the groups', increasing.
    """

    weights: int | tuple[float, ...]
    indices: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def groups(self) -> np.ndarray:
        """The groups' indices, (g,) uint8."""
        return np.array(self.indices, np.uint8)


Shares = int | Sequence[float] | Draw  # how agents are drawn from groups, see populate


@dataclass(frozen=True)
class Action:
    """An action that states name, as one character group plays it.

    name: as states name it.
    stride: meters walked in one cycle; 0 if it plays by time.
    period: seconds of one cycle.
    feet: meters that its feet walk in a cycle; 0 if they stand, or if that was not measured.
    way: meters that it travels in a cycle, which is taken out; 0 likewise.
    plays: why it has this stride.

    The last three change nothing: by them it is told how it plays, and whether feet slide.
    """

    name: str
    stride: float
    period: float
    feet: float = field(default=0.0, compare=False, repr=False)
    way: float = field(default=0.0, compare=False, repr=False)
    plays: Plays = field(default=Plays.IN_PLACE, compare=False, repr=False)


@dataclass(frozen=True)
class Group:
    """A character group (geometrical variety).

    center, radius: meters, the bounding sphere over the whole action. Its center lies on the
        agent's vertical axis, at the height `center` above the feet, so the sphere holds for every
        heading.
    girth: meters, how far from its vertical axis the character reaches over the whole action; 0 if
        that is not known.
    stride: meters walked in one cycle of the action; 0 if the action plays by time.
    period: seconds of one cycle.
    vertices, triangles: counts of each LOD mesh, finest first. A group with fewer LODs than others
        repeats its last.
    lowest: meters from the group's origin up to its soles over the action; 0 if that is near.
    on_ground: whether the group stands on its soles, not on its origin.
    share: of the agents, in proportion to the other groups'.
    scale: the least and the greatest of its agents, see bounding_spheres.cover_sizes.
    actions: those besides its own action that states name. All figures but stride and period hold
        over all actions.
    way, plays: of its own action, as Action's.
    height: meters, of the character as it stands in most of its own action; 0 if not measured.
    variant_of: of a part that agents wear, the group whose agents do; "" for a group of agents.
    chance: of a part, that it is drawn in its slot.
    slot: of the wardrobe of `variant_of`, in which this is a part; "" for a group of agents.
    excludes: the slots that an agent who wears this part goes without.

    These are measured over the action, if the LOD meshes were measured:
    deviations: meters, for each LOD the largest distance found between its surface and the
        character's, both ways.
    bounds: meters, upper bounds of those Hausdorff distances; equal to the deviations if nothing
        else is known.
    rms: meters, for each LOD the root mean square of the distances.
    worst: for each LOD the frame at which it deviates most.
    diagonal: meters, of the character's bounding box.
    shaded: meters, for each LOD: where a pixel shows this much or more, the LOD's shaded picture is
        within WITHIN (validation/shaded_pictures.py) of the character's. 0: at any distance; inf:
        at none. () if the pictures were not compared.
    """

    name: str
    center: float
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
    actions: tuple[Action, ...] = ()
    share: float = 1.0
    scale: tuple[float, float] = (1.0, 1.0)
    variant_of: str = ""
    chance: float = 1.0
    slot: str = ""
    excludes: tuple[str, ...] = ()
    way: float = field(default=0.0, compare=False, repr=False)
    plays: Plays = field(default=Plays.IN_PLACE, compare=False, repr=False)
    height: float = field(default=0.0, compare=False, repr=False)
    girth: float = 0.0

    @property
    def family(self) -> str:
        """The name of the group whose agents wear this, or of the group itself."""
        return self.variant_of or self.name

    @property
    def reach(self) -> float:
        """The radius of the sphere that holds the LODs, too.

        A LOD lies off the character by its bound at most.
        """
        return self.radius + max(self.bounds, default=0.0)

    @property
    def feet(self) -> float:
        """Meters from the group's origin up to the point that stands on the ground."""
        return self.lowest if self.on_ground else 0.0

    def scaled(self, factor: float) -> "Group":
        """Return the group with all lengths multiplied by `factor`, as from units to meters."""
        lengths: dict[str, Any] = {}
        for name in ("center", "radius", "stride", "diagonal", "lowest", "way", "height", "girth"):
            lengths[name] = getattr(self, name) * factor
        for name in ("deviations", "bounds", "rms", "shaded"):
            lengths[name] = tuple(length * factor for length in getattr(self, name))
        actions = tuple(
            replace(
                action,
                stride=action.stride * factor,
                feet=action.feet * factor,
                way=action.way * factor,
            )
            for action in self.actions
        )
        return replace(self, actions=actions, **lengths)

    def knows(self, name: str) -> bool:
        """Return whether the action `name` was measured; its own, "", always."""
        return name in ("", *(action.name for action in self.actions))

    def action(self, name: str) -> Action:
        """Return the action that the group plays where a state names `name`; its own for "".

        CrowdError if it was not measured.
        """
        if name == "":
            return Action("", self.stride, self.period)
        for action in self.actions:
            if action.name == name:
                return action
        reason = f"names the action {name}, which was"
        if mixed_in(name):
            reason = "has cross-fades, which were"
        raise CrowdError(
            f"The state machine {reason} not measured for the character group {self.name}: "
            f"press Populate."
        )

    def __post_init__(self) -> None:
        if len(self.bounds) != len(self.deviations):
            object.__setattr__(self, "bounds", self.deviations)


@dataclass(frozen=True)
class Crowd:
    """n agents at one time, in world space.

    x, y, z: (n,) float64, meters, the feet.
    heading: (n,) float32, radians from +x, counter-clockwise seen from above.
    state, group: (n,) uint8.
    phase_class: (n,) uint8, the shared phase of the action (animation/phase_classes.py).
    wait: (n,) float64, seconds until the timer ends the state; inf without a timer.
    key: (n,) uint64, hashed for the agent's random draws (crowd/random_streams.py).
    mirror: (n,) uint8, whether the map's edge has reflected the agent's way: 1 in x, 2 in y, 3 in
        both.
    pace: (n,) uint8, index of the pace at which the agent walks (Gaits.paces).
    present: (n,) bool, whether the agent is there; None if all are. An agent that is not stands
        where it will enter, or where it left.
    played: (n,) uint8, index of the pace that the agent shows: `pace`, or a step of the cross-fade
        to it; None where no states cross-fade.
    faded: (n,) float32, which part of the agent's cross-fade is over: 1 where none goes on; None
        where no states cross-fade.

    These are 49 bytes per agent, and 5 more with cross-fades. All from `wait` on may be left out.
    Then no timer runs, the keys are those of seed 0, no way is reflected, and all have the first
    pace and are there.
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
    present: np.ndarray | None = None
    played: np.ndarray | None = None
    faded: np.ndarray | None = None

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
        """Return the crowd of these agents alone."""
        return Crowd(**{name: column[agents] for name, column in self.columns.items()})

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The columns by their names, without those that are None."""
        return {name: column for name, column in vars(self).items() if column is not None}

    @property
    def playing(self) -> np.ndarray:
        """The paces (n,) uint8 that agents show."""
        return self.pace if self.played is None else self.played

    @property
    def there(self) -> int:
        """How many agents are there."""
        return len(self) if self.present is None else int(np.count_nonzero(self.present))

    def places(
        self,
        height: np.ndarray | None = None,
        agents: np.ndarray | slice | int = slice(None),
        origin: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y, z of `agents`, (m,) float64 meters each.

        height: (G,) meters above the feet for each group, such as Spheres.center; None for the
            feet.
        agents: indices, a slice, or one index; all agents by default.
        origin: (3,), subtracted from the positions; None for world positions.
        Do not write to the arrays: they may be the crowd's own.
        """
        z = self.z[agents] if height is None else self.z[agents] + height[self.group[agents]]
        x = self.x[agents]
        y = self.y[agents]
        if origin is None:
            return x, y, z
        return x - origin[0], y - origin[1], z - origin[2]
