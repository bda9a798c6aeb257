"""The cost of rendering a build: memory, file size and time.

It follows from counts of what the build holds and what a frame shows.

Engines pay for different things. Blender poses every triangle in the build's collections, shown or
not. Cycles stores each triangle that a frame shows once, for all instances together, with the tree
to trace rays through. EEVEE draws the triangles of each instance again, and all of them once for
each sample of a pixel. So LODs save *unique* triangles in Cycles and *instanced* ones in EEVEE; a
LOD that few agents show saves neither.

The coefficients are fitted to renders by `./crowd-lod bench --costs`, which prints their residuals.
Memory is absolute, and counts what the crowd adds to the scene. Seconds are those of the machine
that `Costs` rest on, the developers' or the user's (cost_fit.py): only their ratios are reported.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from ..errors import CrowdError

NAMES = {"CYCLES": "Cycles", "EEVEE": "EEVEE"}  # of the engines whose costs are known


@dataclass(frozen=True)
class Work:
    """What a build gives an engine to do in F frames.

    Each field is a number, or (F,) float64 with one value per frame.
    posed: triangles of the characters in the build's collections.
    objects: objects of these characters.
    unique: triangles that the frame shows, each counted once for all instances.
    instances: agents shown.
    instanced: triangles of all instances.
    rigs: armatures of the characters.
    bones: bones of these armatures.
    rays: samples of the pixels that agents cover.
    drawn: triangles of all instances, counted once for each sample of a pixel. Only what renders
        are fitted to has it: see Costs.with_samples.
    images: bytes of the images that the characters' materials use.
    keys: keys of the actions of the build's rigs.
    other_keys: keys of all other actions in the file, such as the characters' own.
    meshes: triangles of meshes in the file: of the characters, of their LODs, and of still poses.
    materials: materials of the characters.
    packed: bytes of the images' files that are in the file.
    points: points in the file, one per agent and baked frame.
    """

    posed: float = 0.0
    objects: float = 0.0
    unique: np.ndarray | float = 0.0
    instances: np.ndarray | float = 0.0
    instanced: np.ndarray | float = 0.0
    rigs: float = 0.0
    bones: float = 0.0
    rays: np.ndarray | float = 0.0
    drawn: np.ndarray | float = 0.0
    images: float = 0.0
    keys: float = 0.0
    other_keys: float = 0.0
    meshes: float = 0.0
    materials: float = 0.0
    packed: float = 0.0
    points: float = 0.0

    @property
    def traced(self) -> np.ndarray | float:
        """Rays times log2 of the unique triangles, the levels of a binary tree of them.

        A ray costs more in a deeper tree.
        """
        return self.rays * np.log2(np.maximum(self.unique, 1.0))


# Bytes of memory, and seconds of one processor, for one of each. Cycles: residuals of 20 renders up
# to 3 % of memory; of 48 of seconds, half of them with LODs, 18 % rms. EEVEE on a software GPU: up
# to 60 % of memory in scenes of few agents, which is little there; of seconds 12 % rms of 40
# renders at 1, 4 and 12 samples, 2 to 1,000 agents of 143 to 45,824 triangles. Seconds of images: 8
# renders by Cycles, within 24 %, 13 % rms; EEVEE has the same, for Blender decodes them.
MEMORY: dict[str, dict[str, float]] = {
    "CYCLES": {
        "posed": 36,
        "objects": 12_000,
        "unique": 110,
        "instances": 1800,
        "bones": 12_000,
        "images": 3,
        "keys": 160,
        "meshes": 440,
        "materials": 250_000,
    },
    "EEVEE": {"posed": 335, "unique": 107, "instances": 45_000, "rigs": 1_046_000, "images": 1.4},
}
SECONDS = {
    "CYCLES": {
        "posed": 2e-7,
        "unique": 6.1e-7,
        "instances": 1.29e-5,
        "rigs": 3.7e-3,
        "traced": 1.1e-7,
        "images": 1.1e-8,
    },
    "EEVEE": {
        "posed": 6.7e-8,
        "unique": 2.85e-6,
        "instances": 4.58e-3,
        "instanced": 4.09e-6,
        "drawn": 1.98e-6,
        "images": 1.1e-8,
    },
}
FILE: dict[str, float] = {
    "meshes": 25,
    "rigs": 3_100,
    "keys": 11.3,
    "packed": 1,
    "materials": 8_000,
    "points": 14.6,
}  # bytes, compressed


DEVELOPERS = "a processor of the developers"  # what SECONDS rest on, in words


@dataclass(frozen=True)
class Costs:
    """The seconds that an engine takes for one of each count of Work, on one machine.

    engine: one of NAMES.
    seconds: the count's name -> seconds, with the names of SECONDS[engine].
    basis: what they rest on, in words that follow "costs of".
    """

    engine: str
    seconds: Mapping[str, float]
    basis: str = DEVELOPERS

    def with_samples(self, samples: float) -> "Costs":
        """Return the costs of renders with `samples` of each pixel.

        What EEVEE draws once for each sample is counted to the triangles of instances.
        """
        seconds = dict(self.seconds)
        drawn = seconds.pop("drawn", 0.0)
        if drawn:
            seconds["instanced"] += samples * drawn
        return replace(self, seconds=seconds)


def default_costs(engine: str, samples: float = 1.0) -> Costs:
    """Return the costs of `engine`, one of NAMES, on the developers' machine.

    samples: of each pixel, in the renders.

    CrowdError for any other engine.
    """
    if engine not in NAMES:
        raise CrowdError(
            f"There are no costs of the engine {engine}: choose one of {', '.join(NAMES)}."
        )
    return Costs(engine, SECONDS[engine]).with_samples(samples)


@dataclass(frozen=True)
class Price:
    """The cost of a build.

    memory: bytes, in the frame that takes most.
    file: bytes.
    seconds: mean per frame, on the machine that the costs rest on.
    """

    memory: float
    file: float
    seconds: float

    def share(self, whole: "Price") -> "Price":
        """Return each cost as a part of that of `whole`; 1 where that is 0."""
        pairs = [(getattr(self, each.name), getattr(whole, each.name)) for each in fields(self)]
        return Price(*(own / other if other > 0 else 1.0 for own, other in pairs))


def price(work: Work, costs: Costs) -> Price:
    """Return the price of `work` by `costs`."""
    memory, file, seconds = (
        sum(
            coefficient * np.asarray(getattr(work, name), np.float64)
            for name, coefficient in table.items()
        )
        for table in (MEMORY[costs.engine], FILE, costs.seconds)
    )
    return Price(float(np.max(memory, initial=0.0)), float(file), float(np.mean(seconds)))


@dataclass(frozen=True)
class Holdings:
    """What G groups hold, whatever frames show: each field is (G,), or one number for all.

    rigs, bones: armatures of one character, and their bones.
    objects: of one LOD of a character.
    keys, other_keys, meshes, materials: as of Work, of each group; meshes of the characters alone.
        What two groups share is counted for the first.
    """

    rigs: np.ndarray | float = 1.0
    bones: np.ndarray | float = 0.0
    objects: np.ndarray | float = 1.0
    keys: np.ndarray | float = 0.0
    other_keys: np.ndarray | float = 0.0
    meshes: np.ndarray | float = 0.0
    materials: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Actors:
    """The characters that a build may hold: K LODs of N characters in G groups.

    triangles: (G, K), of each group's LODs.
    group: (N,) intp, the group of each character.
    stored: triangles of LOD meshes in the file.
    finest: (G,), for each group the finest LOD that the build has.
    moved_as: (N,) intp, for each character the one whose rigs move it; None: each has its own.
    """

    triangles: np.ndarray
    group: np.ndarray
    holdings: Holdings = Holdings()
    stored: float = 0.0
    finest: np.ndarray | int = 0
    moved_as: np.ndarray | None = None


def stored_triangles(triangles: np.ndarray) -> float:
    """Return how many triangles of LODs (G, K) a file holds besides LOD 0; a last one once."""
    return float((triangles[:, 1:] * (np.diff(triangles, axis=1) != 0)).sum())


def work_of(
    actors: Actors, shown: np.ndarray, rays: np.ndarray | float = 0.0, known: bool = False
) -> Work:
    """Return the work of a build of `actors` in F frames.

    shown: (F, K, N), how many agents each frame shows with each LOD of each character.
    rays: (F,), or one number.
    known: True for a build of these frames alone: it holds their points, and only the characters
        that they show. Else it holds all characters and no points.
    """
    finest = np.broadcast_to(actors.finest, len(actors.triangles))[actors.group]
    held: np.ndarray = np.array(
        shown.any(axis=0) if known else np.arange(shown.shape[1])[:, None] >= finest
    )
    agents = shown.sum()
    shown = shown.copy()
    # a group with fewer LODs than others shows its last in their place
    for k in range(shown.shape[1] - 1, 0, -1):
        same = (
            (actors.triangles[:, k] == actors.triangles[:, k - 1])[actors.group]
            & held[k]
            & held[k - 1]
        )
        shown[:, k - 1] += shown[:, k] * same
        shown[:, k] *= ~same
        held[k] &= ~same
    each = actors.triangles.T[:, actors.group].astype(np.float64)  # (K, N)
    holdings = actors.holdings
    groups = len(actors.triangles)
    still = np.broadcast_to(holdings.rigs, groups)[actors.group] == 0
    copied = (held * each)[:, still].sum()  # each pose is a mesh of its own
    return Work(
        posed=float((held * each).sum()),
        objects=float((held * np.broadcast_to(holdings.objects, groups)[actors.group]).sum()),
        unique=((shown > 0) * each).sum(axis=(1, 2)),
        instances=shown.sum(axis=(1, 2)).astype(np.float64),
        instanced=(shown * each).sum(axis=(1, 2)),
        rigs=_moving(actors, held, holdings.rigs),
        bones=_moving(actors, held, holdings.bones),
        rays=rays,
        keys=float(np.broadcast_to(holdings.keys, groups).sum()),
        other_keys=float(np.broadcast_to(holdings.other_keys, groups).sum()),
        meshes=float(np.broadcast_to(holdings.meshes, groups).sum() + actors.stored + copied),
        materials=float(np.broadcast_to(holdings.materials, groups).sum()),
        points=float(agents) if known else 0.0,
    )


def _moving(actors: Actors, held: np.ndarray, counts: np.ndarray | float) -> float:
    """Return how many of something a build has that moves characters.

    held: (K, N) bool, the LODs of characters that it has.
    counts: (G,), of one character of each group.
    """
    moved_as = np.arange(held.shape[1]) if actors.moved_as is None else actors.moved_as
    of_group = np.broadcast_to(counts, len(actors.triangles))
    moving = np.zeros(held.shape[1])
    np.maximum.at(moving, moved_as, held.any(axis=0) * of_group[actors.group])
    return float(moving.sum())
