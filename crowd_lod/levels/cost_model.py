"""The cost of rendering a build: memory and time.

It follows from counts of what the build holds and what a frame shows.

Engines pay for different things. Blender poses every triangle in the build's collections, shown or
not. Cycles stores each triangle that a frame shows once, for all instances together, with the tree
to trace rays through. EEVEE draws the triangles of each instance again, and all of them once for
each sample of a pixel. So LODs save *unique* triangles in Cycles and *instanced* ones in EEVEE; a
LOD that few agents show saves neither.

The coefficients are fitted to renders by `./crowd-lod bench --costs` (seconds) and `--estimates`
(memory), which print their residuals.
Memory is absolute, and counts what the crowd adds to the scene. Seconds are those of the
developers' machines: only their ratios are reported.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from ..errors import CrowdError

NAMES = {"CYCLES": "Cycles", "EEVEE": "EEVEE"}  # of the engines whose costs are known


@dataclass(frozen=True)
class Work:
    """What a build gives an engine to do in F frames.

    Each field is a number, or (F,) float64 with one value per frame.
    posed: triangles of the characters in the build's collections.
    unique: triangles that the frame shows, each counted once for all instances.
    split: those of them whose corners have normals of their own.
    instances: agents shown.
    instanced: triangles of all instances.
    rigs: armatures of the characters.
    bones: bones of these armatures.
    rays: samples of the pixels that agents cover.
    drawn_triangles: triangles of all instances, counted once for each sample of a pixel. Only what
        renders are fitted to has it: see default_costs.
    images: bytes of the images that the characters' materials use.
    keys: keys of the actions of the build's rigs.
    other_keys: keys of all other actions in the file, such as the characters' own.
    meshes: bytes in memory of the meshes of characters, LODs and still poses.
    materials: materials of the characters.
    emitting: those of the unique triangles whose material emits light.
    builds: 1, for what any build takes.
    live: 1 for a live build, which Crowd LOD follows in the process that renders; 0 for a bake.
    """

    posed: float = 0.0
    unique: np.ndarray | float = 0.0
    split: np.ndarray | float = 0.0
    instances: np.ndarray | float = 0.0
    instanced: np.ndarray | float = 0.0
    rigs: float = 0.0
    bones: float = 0.0
    rays: np.ndarray | float = 0.0
    drawn_triangles: np.ndarray | float = 0.0
    images: float = 0.0
    keys: float = 0.0
    other_keys: float = 0.0
    meshes: float = 0.0
    materials: float = 0.0
    emitting: np.ndarray | float = 0.0
    builds: float = 0.0
    live: float = 0.0

    @property
    def traced(self) -> np.ndarray | float:
        """Rays times log2 of the unique triangles, the levels of a binary tree of them.

        A ray costs more in a deeper tree.
        """
        return self.rays * np.log2(np.maximum(self.unique, 1.0))


# Bytes of main memory for one of each. Cycles: 16 % rms of 50 builds of fetched characters, 18 % at
# worst of 15 others. EEVEE on a graphics card: 23 % rms of 15 renders. docs/notes/costs.md has the
# builds.
MEMORY: dict[str, dict[str, float]] = {
    "CYCLES": {
        "builds": 4_400_000,
        "live": 6_900_000,
        "unique": 208,
        "emitting": 547,
        "instances": 2500,
        "bones": 13_300,
        "images": 1.56,
        "keys": 249,
        "other_keys": 146,
        "meshes": 3.4,
        "materials": 300_000,
    },
    "EEVEE": {
        "posed": 60,
        "unique": 105,
        "instances": 5000,
        "bones": 14_700,
        "images": 1.56,
        "keys": 225,
        "other_keys": 140,
        "meshes": 1.7,
        "materials": 850_000,
    },
}
# Seconds for one of each. Cycles, of one processor: 3 % rms of 24 renders, 6 %
# of 16 crowds that it does not know. EEVEE, of a graphics card (NVIDIA H100): 9 % rms of 39 renders
# at 1 to 16 samples, 2 to 10,000 agents of 143 to 45,824 triangles. Images: 8 renders by Cycles,
# 13 % rms, 24 % at worst; EEVEE has the same, for Blender decodes them.
SECONDS = {
    "CYCLES": {
        "posed": 9.6e-8,
        "unique": 4.2e-7,
        "split": 1.3e-7,
        "instances": 9.2e-6,
        "rigs": 8.9e-4,
        "traced": 1.65e-7,
        "images": 1.1e-8,
    },
    "EEVEE": {
        "posed": 3e-8,
        "unique": 6.6e-8,
        "instances": 5.5e-6,
        "instanced": 1.4e-8,
        "drawn_triangles": 3.2e-9,
        "rays": 2.9e-8,
        "images": 1.1e-8,
    },
}
# what SECONDS rest on, in words
DEVELOPERS = {
    "CYCLES": "a reference CPU",
    "EEVEE": "a reference GPU",
}


# by engine: how many times the memory and the time that is foretold were measured, at least and at
# most (docs/notes/costs.md)
SEEN = {"CYCLES": ((0.5, 1.7), (0.8, 1.5))}


@dataclass(frozen=True)
class Costs:
    """The seconds that an engine takes for one of each count of Work, on one machine.

    engine: one of NAMES.
    seconds: the count's name -> seconds, with the names of SECONDS[engine].
    basis: what they rest on, in words that follow "costs of".
    """

    engine: str
    seconds: Mapping[str, float]
    basis: str


def default_costs(engine: str, samples: float = 1.0) -> Costs:
    """Return the costs of `engine`, one of NAMES, on the developers' machine.

    samples: of each pixel, in the renders.

    CrowdError for any other engine.
    """
    if engine not in NAMES:
        raise CrowdError(
            f"There are no costs of the engine {engine}: choose one of {', '.join(NAMES)}."
        )
    seconds = dict(SECONDS[engine])
    # what EEVEE draws once for each sample is counted to the triangles of instances
    drawn_triangles = seconds.pop("drawn_triangles", 0.0)
    if drawn_triangles:
        seconds["instanced"] += samples * drawn_triangles
    return Costs(engine, seconds, DEVELOPERS[engine])


@dataclass(frozen=True)
class Price:
    """The cost of a build.

    memory: bytes, in the frame that takes most.
    seconds: mean per frame, on the machine that the costs rest on.
    """

    memory: float
    seconds: float

    def share(self, whole: "Price") -> "Price":
        """Return each cost as a part of that of `whole`; 1 where that is 0."""
        pairs = [(getattr(self, each.name), getattr(whole, each.name)) for each in fields(self)]
        return Price(*(own / other if other > 0 else 1.0 for own, other in pairs))


def price(work: Work, costs: Costs) -> Price:
    """Return the price of `work` by `costs`."""
    memory, seconds = (
        sum(
            coefficient * np.asarray(getattr(work, name), np.float64)
            for name, coefficient in table.items()
        )
        for table in (MEMORY[costs.engine], costs.seconds)
    )
    return Price(float(np.max(memory, initial=0.0)), float(np.mean(seconds)))


@dataclass(frozen=True)
class Holdings:
    """What G groups hold, whatever frames show: each field is (G,), or one number for all.

    rigs, bones: armatures of one character, and their bones.
    keys, other_keys, meshes, materials, builds, live: as of Work, of each group; without LODs. What
        groups share is counted for the first.
    triangle: bytes in memory of a triangle of a mesh, with its vertices.
    split: part of the characters' triangles whose corners have normals of their own.
    emitting: part of them whose material emits light.
    """

    rigs: np.ndarray | float = 1.0
    bones: np.ndarray | float = 0.0
    keys: np.ndarray | float = 0.0
    other_keys: np.ndarray | float = 0.0
    meshes: np.ndarray | float = 0.0
    triangle: np.ndarray | float = 0.0
    split: np.ndarray | float = 0.0
    materials: np.ndarray | float = 0.0
    emitting: np.ndarray | float = 0.0
    builds: np.ndarray | float = 0.0
    live: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Actors:
    """The characters that a build may hold: K LODs of N characters in G groups.

    triangles: (G, K), of each group's LODs.
    group: (N,) intp, the group of each character.
    stored: (G,), triangles of LOD meshes in the file.
    finest: (G,), for each group the finest LOD that the build has.
    moved_as: (N,) intp, for each character the one whose rigs move it; None: each has its own.
    held: (K, N) bool, of the LODs of characters those that a build of any frame holds, such as a
        shot plan's; None: all from `finest` on.
    """

    triangles: np.ndarray
    group: np.ndarray
    holdings: Holdings = Holdings()
    stored: np.ndarray | float = 0.0
    finest: np.ndarray | int = 0
    moved_as: np.ndarray | None = None
    held: np.ndarray | None = None

    def held_by(self, shown_agents: np.ndarray, known: bool) -> np.ndarray:
        """Return the LODs of characters that a build holds, (K, N) bool.

        shown_agents, known: as of work_of.
        """
        if known:
            return np.array(shown_agents.any(axis=0))
        finest = np.broadcast_to(self.finest, len(self.triangles))[self.group]
        is_held = np.arange(shown_agents.shape[1])[:, None] >= finest
        return is_held if self.held is None else is_held & self.held

    @property
    def split(self) -> np.ndarray:
        """(K, N) float64, part of the triangles whose corners have normals of their own.

        Those of LODs have, which keep the character's shading so.
        """
        parts = np.ones(self.triangles.shape[::-1])
        parts[0] = self.holdings.split
        return parts[:, self.group]


def stored_triangles(triangles: np.ndarray) -> np.ndarray:
    """Return how many triangles of LODs a file holds besides LOD 0, (G,) float64; a last one once.

    triangles: (G, K), of each group's LODs.
    """
    return (triangles[:, 1:] * (np.diff(triangles, axis=1) != 0)).sum(axis=1).astype(np.float64)


def work_of(
    actors: Actors, shown_agents: np.ndarray, rays: np.ndarray | float = 0.0, known: bool = False
) -> Work:
    """Return the work of a build of `actors` in F frames.

    shown_agents: (F, K, N), how many agents each frame shows with each LOD of each character.
    rays: (F,), or one number.
    known: True for a build of these frames alone, which holds only the characters that they show.
        Else it holds all characters.
    """
    is_held = actors.held_by(shown_agents, known)
    shown_agents = shown_agents.copy()
    # a group with fewer LODs than others shows its last in their place
    for k in range(shown_agents.shape[1] - 1, 0, -1):
        same = (
            (actors.triangles[:, k] == actors.triangles[:, k - 1])[actors.group]
            & is_held[k]
            & is_held[k - 1]
        )
        if same.any():
            shown_agents[:, k - 1] += shown_agents[:, k] * same
            shown_agents[:, k] *= ~same
            is_held[k] &= ~same
    triangles = actors.triangles.T[:, actors.group].astype(np.float64)  # (K, N)
    holdings = actors.holdings
    groups = len(actors.triangles)
    emitting, rigs = (
        np.broadcast_to(each, groups)[actors.group] for each in (holdings.emitting, holdings.rigs)
    )
    # each pose is a mesh of its own
    poses = np.bincount(actors.group, (is_held * triangles).sum(axis=0) * (rigs == 0), groups)
    more = actors.stored + poses
    return Work(
        posed=float((is_held * triangles).sum()),
        unique=((shown_agents > 0) * triangles).sum(axis=(1, 2)),
        split=((shown_agents > 0) * triangles * actors.split).sum(axis=(1, 2)),
        instances=shown_agents.sum(axis=(1, 2)).astype(np.float64),
        instanced=(shown_agents * triangles).sum(axis=(1, 2)),
        rigs=_moving(actors, is_held, holdings.rigs),
        bones=_moving(actors, is_held, holdings.bones),
        rays=rays,
        keys=float(np.broadcast_to(holdings.keys, groups).sum()),
        other_keys=float(np.broadcast_to(holdings.other_keys, groups).sum()),
        meshes=float(np.sum(holdings.meshes + more * holdings.triangle)),
        materials=float(np.broadcast_to(holdings.materials, groups).sum()),
        emitting=((shown_agents > 0) * triangles * emitting).sum(axis=(1, 2)),
        builds=float(np.broadcast_to(holdings.builds, groups).sum()),
        live=float(np.broadcast_to(holdings.live, groups).sum()),
    )


def _moving(actors: Actors, is_held: np.ndarray, counts: np.ndarray | float) -> float:
    """Return how many of something a build has that moves characters.

    is_held: (K, N) bool, the LODs of characters that it has.
    counts: (G,), of one character of each group.
    """
    moved_as = np.arange(is_held.shape[1]) if actors.moved_as is None else actors.moved_as
    of_group = np.broadcast_to(counts, len(actors.triangles))
    moving = np.zeros(is_held.shape[1])
    np.maximum.at(moving, moved_as, is_held.any(axis=0) * of_group[actors.group])
    return float(moving.sum())
