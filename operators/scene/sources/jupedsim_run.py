"""A crowd's trajectories, simulated by JuPedSim (https://www.jupedsim.org), where it is installed.

JuPedSim brings Shapely, which does the geometry here. Both are imported when a simulation starts.
"""

import sys
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from math import ceil, sqrt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.progress import Workload
from ....crowd_lod.world.maps import LabelMap

# JuPedSim needs only these to simulate; its wheel also requires Qt and VTK, 1.2 GB, for a viewer.
PACKAGES = "jupedsim shapely deprecated wrapt"
# meters and seconds: JuPedSim's defaults for people
RADIUS = 0.2
TIME_GAP = 1.0
SPEED = (1.34, 0.26, 0.7, 2.0)  # meters per second: mean, deviation, least and most (Weidmann 1993)
# meters between two agents at the start, and from an agent to a wall
APART = 0.45
OFF_WALL = 0.25
LONGEST_STEP = 0.02  # seconds
# What finding the site costs, and the places of agents on it, as parts of the simulation
SITE, PLACES = 0.01, 0.04


@dataclass(frozen=True)
class SimulationRequest:
    """What to simulate.

    world: the label map.
    walls, starts, goals: (L,) bool: the labels that nobody enters, that agents spawn on, and that
        they walk to.
    obstacles: (k, 2, 2) float64, world meters: segments that nobody crosses, such as outlines of
        meshes. Nobody enters what closed ones enclose.
    nearest: whether agents walk to the nearest goal; else each draws one.
    count, seed: of agents.
    seconds: how long.
    rate: frames a second in the file.
    """

    world: LabelMap
    walls: np.ndarray
    starts: np.ndarray
    goals: np.ndarray
    obstacles: np.ndarray
    nearest: bool
    count: int
    seed: int
    seconds: float
    rate: float


def simulate(request: SimulationRequest, path: Path) -> Generator[float, None, int]:
    """Simulate people, and write JuPedSim's SQLite file of trajectories to the new file `path`.

    Positions are in meters from the middle of the map's area. Agents leave at a goal.
    Yields the progress, 0 to 1, and returns how many agents arrived.
    CrowdError if JuPedSim is not installed, or cannot simulate it.
    """
    jupedsim = _module("jupedsim")
    steps = ceil(1 / (request.rate * LONGEST_STEP))  # of each frame in the file
    whole = ceil(request.seconds * request.rate) * steps
    work = Workload((SITE + PLACES + 1) * whole)
    ground, starts, targets = _site(request)
    yield work.did(SITE * whole)
    draws = np.random.default_rng(request.seed)
    places = _places(starts, request.count, draws)
    yield work.did(PLACES * whole)
    writer = jupedsim.SqliteTrajectoryWriter(output_file=path, every_nth_frame=steps)
    try:
        simulation = jupedsim.Simulation(
            model=jupedsim.CollisionFreeSpeedModel(), geometry=ground, dt=1 / (request.rate * steps)
        )
        numbered = _Numbered(
            simulation, _enter(simulation, places, targets, request.nearest, draws)
        )
        writer.begin_writing(numbered)
        writer.write_iteration_state(numbered)
        while simulation.agent_count() and simulation.iteration_count() < whole:
            simulation.iterate()
            writer.write_iteration_state(numbered)
            yield work.did(1)
        return request.count - simulation.agent_count()
    except (RuntimeError, jupedsim.TrajectoryWriter.Exception) as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".")
        raise CrowdError(f"JuPedSim cannot simulate this crowd: {reason}.") from None
    finally:
        writer.close()


def has_jupedsim() -> bool:
    """Return whether JuPedSim is installed where this Blender finds it."""
    return find_spec("jupedsim") is not None


def _module(name: str) -> Any:
    """Return the module; CrowdError with the command to install it if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise CrowdError(
            f"Simulating needs JuPedSim, which this Python lacks ({error}): run {_remedy()} in a "
            f"terminal, then start "
            "Blender again."
        ) from None


def _remedy() -> str:
    """Return the command that installs JuPedSim where this Blender finds it."""
    place = ""
    if sys.prefix == sys.base_prefix:  # not in an environment of its own, such as a checkout's
        place = f' --target "{bpy.utils.user_resource("SCRIPTS", path="modules")}"'
    return f'"{sys.executable}" -m pip install --no-deps{place} {PACKAGES}'


def _site(request: SimulationRequest) -> tuple[Any, Any, list[Any]]:
    """Return the Polygon to walk in, the area to spawn in, and the goals, convex Polygons."""
    shapely = _module("shapely")

    def polygons(chosen: np.ndarray) -> list[Any]:
        return walkable_polygons(request.world, chosen[request.world.labels])

    ground = shapely.union_all(polygons(~request.walls)).difference(_solid(request))
    starts = shapely.union_all(polygons(request.starts))
    goals = polygons(request.goals)
    best = None, None, []
    for part in shapely.get_parts(ground):
        start_area = starts.intersection(part.buffer(-OFF_WALL))
        targets = [
            _target(piece, part)
            for goal in goals
            for piece in shapely.get_parts(goal.intersection(part))
        ]
        targets = [target for target in targets if target is not None]
        if (
            targets
            and not start_area.is_empty
            and (best[0] is None or start_area.area > best[1].area)
        ):
            best = part, start_area, targets
    if best[0] is None:
        raise CrowdError(
            "No ground has both a place to spawn and a goal: paint a goal's label that the starts "
            "are not walled off from, or "
            "name other labels in Goals and Spawn Labels."
        )
    return best


def walkable_polygons(world: LabelMap, cells: np.ndarray) -> list[Any]:
    """Return the cells that are True as Polygons in meters from the middle of the map's area.

    cells: (rows, columns) bool. Cells that share sides make one Polygon. Polygons are in the order
        of their first cells.
    """
    shapely = _module("shapely")
    changes = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, begin = np.nonzero(changes == 1)
    _, end = np.nonzero(changes == -1)  # of the same runs of cells
    runs = shapely.box(begin, row, end, row + 1)
    parts = shapely.get_parts(shapely.union_all(runs).simplify(0))
    ordered = sorted(parts, key=lambda part: min((y, x) for x, y in part.exterior.coords))
    middle = np.array(cells.shape[::-1]) / 2
    return [
        shapely.transform(part, lambda corners: (corners - middle) * world.cell) for part in ordered
    ]


def _solid(request: SimulationRequest) -> Any:
    """Return the ground under the obstacles; lines that enclose nothing get a width of 2 cm."""
    shapely = _module("shapely")
    area = request.world.area
    middle = (area.x_min + area.x_max) / 2, (area.y_min + area.y_max) / 2
    # cut where they cross
    lines = shapely.union_all(shapely.linestrings(request.obstacles - middle))
    closed = shapely.get_parts(shapely.polygonize([lines]))
    return shapely.union_all([*closed, lines.buffer(0.01, cap_style="square", join_style="mitre")])


def _target(goal: Any, part: Any) -> Any:
    """Return a convex Polygon in `goal` that agents in `part` can walk to; None if there is none.

    JuPedSim takes only convex ones.
    """
    shapely = _module("shapely")
    if goal.geom_type != "Polygon":  # where it only touches the part
        return None
    hull = goal.convex_hull
    if not part.covers(hull):
        within = [
            triangle
            for triangle in shapely.get_parts(shapely.delaunay_triangles(goal))
            if goal.covers(triangle)
        ]
        hull = max(within, key=lambda triangle: triangle.area, default=None)
    return hull


def _places(starts: Any, count: int, draws: np.random.Generator) -> np.ndarray:
    """Return (count, 2) float64 places in `starts`, APART from each other.

    They are those of a grid, jittered and shuffled.

    CrowdError if so many do not fit.
    """
    shapely = _module("shapely")
    shapely.prepare(starts)
    least, most = np.reshape(starts.bounds, (2, 2))
    between = max(sqrt(starts.area / max(count, 1)), APART)
    while True:
        grid = np.stack(
            np.meshgrid(
                *(np.arange(a, b + between, between) for a, b in zip(least, most, strict=True))
            ),
            axis=-1,
        )
        places = grid.reshape(-1, 2)
        turn = 2 * np.pi * draws.random(len(places))
        far = (between - APART) / 2 * np.sqrt(draws.random(len(places)))
        places = places + np.stack([far * np.cos(turn), far * np.sin(turn)], axis=1)
        places = places[shapely.contains_xy(starts, *places.T)]
        if len(places) >= count:
            return draws.permutation(places)[:count]
        if between == APART:
            raise CrowdError(
                f"The crowd has {count:,} agents, and only {len(places):,} find room to spawn "
                f"{APART} m apart: lower Agents, or "
                "paint more ground to spawn on."
            )
        between = max(0.9 * between, APART)


def _enter(
    simulation: Any,
    places: np.ndarray,
    targets: list[Any],
    nearest: bool,
    draws: np.random.Generator,
) -> list[int]:
    """Add an agent at each of `places` (n, 2) with one of `targets` as its goal; return ids."""
    jupedsim = _module("jupedsim")
    shapely = _module("shapely")
    stages = [simulation.add_exit_stage(target) for target in targets]
    journeys = [simulation.add_journey(jupedsim.JourneyDescription([stage])) for stage in stages]
    target_of = draws.integers(len(targets), size=len(places))
    if nearest:
        target_of = np.array(
            [shapely.distance(shapely.points(places), target) for target in targets]
        ).argmin(axis=0)
    mean, deviation, least, most = SPEED
    speeds = np.clip(draws.normal(mean, deviation, len(places)), least, most)
    return [
        simulation.add_agent(
            jupedsim.CollisionFreeSpeedModelAgentParameters(
                position=tuple(place),
                desired_speed=speed,
                radius=RADIUS,
                time_gap=TIME_GAP,
                journey_id=journeys[goal],
                stage_id=stages[goal],
            )
        )
        for place, speed, goal in zip(
            places.tolist(), speeds.tolist(), target_of.tolist(), strict=True
        )
    ]


class _Numbered:
    """A simulation for its writer, agents numbered from 0; JuPedSim counts on from run to run."""

    def __init__(self, simulation: Any, ids: list[int]) -> None:
        self._simulation = simulation
        self._numbers = {own: number for number, own in enumerate(ids)}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def agents(self) -> Iterator[SimpleNamespace]:
        for agent in self._simulation.agents():
            yield SimpleNamespace(
                id=self._numbers[agent.id], position=agent.position, orientation=agent.orientation
            )
