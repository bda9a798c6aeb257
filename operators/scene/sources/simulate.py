"""From the settings of a scene's simulated crowds to the files that they follow, and the press."""

from collections.abc import Generator, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Group
from ....crowd_lod.crowd.state_machine import StateMachine
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted, number
from ....crowd_lod.output import files
from ....crowd_lod.progress import Workload
from ....crowd_lod.tracks.reading import drawn_groups, write_npz
from ....crowd_lod.world.first_frame import check_counts
from ....crowd_lod.world.maps import Area, LabelMap
from ....crowd_lod.world.rasterize import section
from ...blender import mesh_data, scene_data, stored_values
from ...blender.output_folders import full_path, output_path
from ..characters.strides import WALKING
from ..machine import kept_meshes, map_areas, tracks_source
from ..machine.scene_world import area_of, machine_of, world_of
from . import jupedsim_run, spawn_source
from .crowd_sources import draw_of
from .jupedsim_run import Walked
from .simulation_ground import footprint, solid_ground, walkable_polygons
from .simulation_sites import APART, Goal, People, load
from .simulation_source import file_digest, file_name, is_simulated, simulated_crowds

KNEE = 0.5  # meters above the ground, where the meshes of obstacles are cut
LEAST_GOAL = 0.5  # meters: half the width of a goal that is a point
# What reading the scene, the run, and reading its files cost.
SITE, RUN, READ = 1, 90, 9


def simulate_changed(
    scene: bpy.types.Scene, groups: Sequence[Group], depsgraph: bpy.types.Depsgraph
) -> Generator[float, None, str]:
    """Simulate the scene's crowds whose source it is, unless their files are up to date.

    Places on objects must have been read. Yields the progress and returns a sentence, "" if nothing
    was done. CrowdError if they cannot be simulated: then the scene is as it was.

    groups: the measured groups; () where they are not known.
    """
    crowds = simulated_crowds(scene)
    digest = file_digest(scene, groups)
    if is_simulated(crowds, digest):
        return ""
    work = Workload(SITE + RUN + READ)
    place = output_path(scene, "simulation")
    names = [file_name(crowd, digest) for crowd in crowds]
    with files.staged(full_path(place), *names) as part:
        paths = [part / name for name in names]
        said = yield from work.take(simulate_into(paths, scene, groups, depsgraph), SITE + RUN)
    for crowd, name in zip(crowds, names, strict=True):
        crowd.simulation_file = f"{place}/{name}"
    reading = tracks_source.read_files(crowds, scene_data.frame_rate(scene))
    yield from work.take(reading, READ)
    return said


def lay_out(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Lay the simulated crowds' areas over their maps, and read their places on objects."""
    for crowd in simulated_crowds(scene):
        map_areas.make(crowd, depsgraph)
        spawn_source.read_places(crowd, scene.crowd_lod.forward, depsgraph)


def simulate_into(
    paths: Sequence[Path],
    scene: bpy.types.Scene,
    groups: Sequence[Group],
    depsgraph: bpy.types.Depsgraph,
) -> Generator[float, None, str]:
    """Simulate the scene's crowds, and write a file of each to `paths`.

    Yields the progress and returns a sentence on the run. The scene stays as it is.
    """
    shapely = load("shapely")
    crowds = simulated_crowds(scene)
    meters = scene_data.meters(scene)
    origin = np.array(crowds[0].center[:2]) * meters
    readers = [_SimulatedCrowd(crowd, groups, origin, depsgraph) for crowd in crowds]
    people = [reader.people() for reader in readers]
    walls = shapely.union_all([reader.walls for reader in readers])
    obstacles = solid_ground(np.concatenate([reader.obstacles() for reader in readers]))
    ground = shapely.union_all([reader.ground for reader in readers]) - walls - obstacles
    seconds = max(crowd.simulated_seconds for crowd in crowds)
    walked, nearest = yield from jupedsim_run.simulate(ground, people, seconds)
    asked = sum(len(each.speeds) for each in people if not each.per_minute)
    for crowd, outcome, path in zip(crowds, walked, paths, strict=True):
        x, y = origin - np.array(crowd.center[:2]) * meters
        rows = outcome.rows
        write_npz(path, replace(rows, x=rows.x + x, y=rows.y + y))
    return _sentence(walked, nearest, seconds, asked)


def _sentence(walked: Sequence[Walked], nearest: float, seconds: float, asked: int) -> str:
    """Return a sentence on the run.

    asked: how many were to be there at first.
    """
    came, left, stayed, at_first = (
        sum(getattr(each, name) for each in walked)
        for name in ("came", "left", "stayed", "at_first")
    )
    apart = f" The nearest two came within {nearest:.2f} m." if np.isfinite(nearest) else ""
    lost = asked - at_first
    crowded = (
        f" {lost:,} are left out: their places are off the ground, or less than {APART} m from "
        f"another's."
        if lost > 0
        else ""
    )
    return (
        f"{counted(came, 'agent was', 'agents were')} simulated for {number(seconds)} s: "
        f"{left:,} left, {stayed:,} stopped at a goal.{apart}{crowded}"
    )


class _SimulatedCrowd:
    """Reads one crowd's part of the simulation, in meters from the `origin` of all crowds.

    ground, walls: Polygons.
    """

    def __init__(
        self,
        crowd: bpy.types.PropertyGroup,
        groups: Sequence[Group],
        origin: np.ndarray,
        depsgraph: bpy.types.Depsgraph,
    ):
        stored_values.check(crowd)
        check_counts(crowd.count)
        self._crowd = crowd
        self._groups = groups
        self._origin = origin
        self._depsgraph = depsgraph
        self._meters = scene_data.meters(crowd.id_data)
        self._machine = machine_of(crowd)
        world = world_of(crowd, self._machine)
        edges = (edge * self._meters for edge in astuple(world.area))
        self._world = LabelMap(world.labels, Area(*edges))
        walls = _labels_in(self._machine, "Walls", crowd.wall_labels, "wall")
        self._walls = walls & ~_labels_in(self._machine, "Goals", self._goal_labels())
        self.ground = self._polygons(~self._walls)
        self.walls = self._polygons(self._walls)

    def people(self) -> People:
        """Return who is simulated, from where and to where."""
        crowd = self._crowd
        starts, count = self._starts()
        return People(
            crowd.name,
            starts,
            [self._goal(goal) for goal in crowd.goals] or [self._exit()],
            crowd.goal_choice == "NEAREST",
            self._speeds(count),
            crowd.people_a_minute,
            crowd.seed,
        )

    def obstacles(self) -> np.ndarray:
        """Return the outlines of the obstacles at knee height, (k, 2, 2) float64 meters."""
        crowd = self._crowd
        cuts = [np.empty((0, 2, 2))]
        items = () if crowd.obstacles is None else crowd.obstacles.all_objects
        knee = crowd.center[2] + KNEE / self._meters
        for item in items:
            if item.type == "MESH":
                mesh = mesh_data.world_mesh(item.evaluated_get(self._depsgraph))
                cuts.append(section(mesh.points, mesh.triangles, knee))
        return self._from_origin(np.concatenate(cuts))

    def _starts(self) -> tuple[Any, int]:
        """Return where people start, Polygons or places (k, 2), and how many people there are."""
        crowd = self._crowd
        places = spawn_source.places_of(crowd, area_of(crowd))
        if places is not None:
            count = crowd.count if crowd.people_a_minute else len(places)
            return self._from_origin(places.points[:, :2]), count
        labels = self._machine.spawn
        if crowd.spawn_labels.strip():
            labels = _labels_in(self._machine, "Spawn Labels", crowd.spawn_labels)
        exits = [goal.label for goal in crowd.goals if goal.object is None and goal.is_exit]
        leaving = _labels_in(self._machine, "Goals", ", ".join(exits), "exit")
        return self._polygons(labels & ~self._walls & ~leaving), crowd.count

    def _goal_labels(self) -> str:
        return ", ".join(goal.label for goal in self._crowd.goals if goal.object is None)

    def _goal(self, goal: bpy.types.PropertyGroup) -> Goal:
        if goal.object is None:
            if not goal.label.strip():
                raise CrowdError(f"The goal {goal.name} has no place: choose its Object or Label.")
            labels = _labels_in(self._machine, "Goals", goal.label)
            return Goal(self._polygons(labels), goal.share, goal.is_exit)
        item = goal.object
        shapes = kept_meshes.evaluated_meshes([item], self._depsgraph)
        points = [read.points[:, :2] for _, _, read in shapes]
        if points:
            return Goal(
                footprint(self._from_origin(np.concatenate(points)), 0.0), goal.share, goal.is_exit
            )
        matrix = np.array(item.evaluated_get(self._depsgraph).matrix_world, np.float64)
        size = item.empty_display_size * np.abs(np.linalg.det(matrix[:3, :3])) ** (1 / 3)
        around = max(size * self._meters, LEAST_GOAL)
        place = self._from_origin(matrix[None, :2, 3])
        return Goal(footprint(place, around), goal.share, goal.is_exit)

    def _exit(self) -> Goal:
        """Return the goal of a crowd without any in its list."""
        labels = _labels_in(self._machine, "Goals", "", "exit")
        if not labels.any():
            raise CrowdError(
                f"{self._crowd.name} has no goal: add an object or a label that people walk to "
                f"below Goals. The state machine has {', '.join(self._machine.labels)}."
            )
        return Goal(self._polygons(labels))

    def _speeds(self, count: int) -> np.ndarray:
        """Return how fast each person walks, (count,) float64 m/s."""
        crowd = self._crowd
        mean, deviation, least, most = WALKING
        draws = np.random.default_rng((crowd.seed, 1))
        speeds = np.clip(draws.normal(mean, deviation, count), least, most)
        if crowd.walking_speed != "STRIDE" or not self._groups:
            return speeds
        strides = [
            group.stride * self._meters / group.period if group.period else 0.0
            for group in self._groups
        ]
        choices = draw_of(crowd, self._groups).groups
        own = np.array(strides)[drawn_groups(np.arange(count), choices, crowd.seed)]
        return np.where(own > 0, own, speeds)

    def _polygons(self, labels: np.ndarray) -> Any:
        """Return the ground of these labels, (L,) bool."""
        cells = labels[self._world.labels]
        return load("shapely").union_all(walkable_polygons(self._world, cells, self._origin))

    def _from_origin(self, places: np.ndarray) -> np.ndarray:
        """Return places (..., 2) of the scene in meters from the origin."""
        return places * self._meters - self._origin


def _labels_in(machine: StateMachine, setting: str, text: str, usual: str = "") -> np.ndarray:
    """Return which labels the text names, (L,) bool; CrowdError if there is no such label.

    usual: the label that counts if the text is empty, where the state machine has it.
    """
    names = {name.strip() for name in text.split(",")} - {""}
    for name in sorted(names - set(machine.labels)):
        raise CrowdError(
            f"{setting} names the label {name}, and there is none: the state machine has "
            f"{', '.join(machine.labels)}."
        )
    return np.array([label in (names or {usual}) for label in machine.labels])
