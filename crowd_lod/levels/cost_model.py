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
    unique: triangles that the frame shows, each counted once for all instances.
    instances: agents shown.
    instanced: triangles of all instances.
    rigs: armatures of the characters.
    rays: samples of the pixels that agents cover.
    drawn: triangles of all instances, counted once for each sample of a pixel. Only what renders
        are fitted to has it: see Costs.with_samples.
    images: bytes of the images that the characters' materials use.
    stored: triangles of LOD meshes in the file.
    points: points in the file, one per agent and baked frame.
    """

    posed: float = 0.0
    unique: np.ndarray | float = 0.0
    instances: np.ndarray | float = 0.0
    instanced: np.ndarray | float = 0.0
    rigs: float = 0.0
    rays: np.ndarray | float = 0.0
    drawn: np.ndarray | float = 0.0
    images: float = 0.0
    stored: float = 0.0
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
MEMORY = {
    "CYCLES": {"posed": 30, "unique": 133, "instances": 1800, "rigs": 551_000, "images": 1.4},
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
FILE = {"stored": 42, "rigs": 17_200, "points": 14.6}  # bytes, compressed


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
class Actors:
    """The characters that a build may hold: K LODs of N characters in G groups.

    triangles: (G, K), of each group's LODs.
    group: (N,) intp, the group of each character.
    rigs: (G,), armatures of one character.
    stored: triangles of LOD meshes in the file.
    finest: (G,), for each group the finest LOD that the build has.
    moved_as: (N,) intp, for each character the one whose rigs move it; None: each has its own.
    """

    triangles: np.ndarray
    group: np.ndarray
    rigs: np.ndarray
    stored: float = 0.0
    finest: np.ndarray | int = 0
    moved_as: np.ndarray | None = None


def work_of(
    actors: Actors, shown_agents: np.ndarray, rays: np.ndarray | float = 0.0, known: bool = False
) -> Work:
    """Return the work of a build of `actors` in F frames.

    shown_agents: (F, K, N), how many agents each frame shows with each LOD of each character.
    rays: (F,), or one number.
    known: True for a build of these frames alone: it holds their points, and only the characters
        that they show. Else it holds all characters and no points.
    """
    finest = np.broadcast_to(actors.finest, len(actors.triangles))[actors.group]
    is_held: np.ndarray = np.array(
        shown_agents.any(axis=0) if known else np.arange(shown_agents.shape[1])[:, None] >= finest
    )
    agents = shown_agents.sum()
    shown_agents = shown_agents.copy()
    # a group with fewer LODs than others shows its last in their place
    for k in range(shown_agents.shape[1] - 1, 0, -1):
        same = (
            (actors.triangles[:, k] == actors.triangles[:, k - 1])[actors.group]
            & is_held[k]
            & is_held[k - 1]
        )
        shown_agents[:, k - 1] += shown_agents[:, k] * same
        shown_agents[:, k] *= ~same
        is_held[k] &= ~same
    triangles = actors.triangles.T[:, actors.group].astype(np.float64)  # (K, N)
    rigs = np.zeros(is_held.shape[1])
    moved_as = actors.moved_as
    mover = np.arange(is_held.shape[1]) if moved_as is None else moved_as
    np.maximum.at(rigs, mover, is_held.any(axis=0) * actors.rigs[actors.group])
    return Work(
        posed=float((is_held * triangles).sum()),
        unique=((shown_agents > 0) * triangles).sum(axis=(1, 2)),
        instances=shown_agents.sum(axis=(1, 2)).astype(np.float64),
        instanced=(shown_agents * triangles).sum(axis=(1, 2)),
        rigs=float(rigs.sum()),
        rays=rays,
        stored=actors.stored,
        points=float(agents) if known else 0.0,
    )
