"""The operator Simulate with JuPedSim: from a crowd's settings to a file that moves it."""

from collections.abc import Generator
from dataclasses import astuple, replace
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.crowd.state_machine import StateMachine
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted, number, printable
from ....crowd_lod.output import files
from ....crowd_lod.world.first_frame import check_counts
from ....crowd_lod.world.maps import Area, LabelMap
from ....crowd_lod.world.rasterize import section
from ...blender import mesh_data, scene_data, stored_values
from ...blender.operator import Stepwise
from ...settings import needs
from ...settings.crowds import crowds_of, index_of_active, set_lengths
from ..machine.scene_world import machine_of, world_of
from .jupedsim_run import SimulationRequest, simulate

KNEE = 0.5  # meters above the ground, where the meshes of obstacles are cut


def simulate_crowd(scene: bpy.types.Scene, index: int, path: Path) -> Generator[float, None, str]:
    """Simulate a crowd of `scene`, and write the trajectories to `path`, which must not exist.

    Yields the progress, and returns a sentence on the result. The scene stays as it is.
    CrowdError if it cannot be simulated.

    index: 0 for the scene's first crowd.
    """
    request = _request_of(scene, index)
    arrived = yield from simulate(request, path)
    return (
        f"{counted(request.count, 'agent was', 'agents were')} simulated for "
        f"{number(request.seconds)} s; {arrived:,} arrived."
    )


def follow(scene: bpy.types.Scene, index: int, path: str) -> None:
    """Let the crowd `index` of `scene` follow the file of trajectories at `path`.

    `simulate_crowd` writes it.
    """
    crowd = crowds_of(scene.crowd_lod)[index]
    crowd.source = "FILE"
    crowd.tracks_file = path
    crowd.tracks_columns = ""
    crowd.tracks_unit = "M"
    crowd.tracks_rate = 0
    crowd.tracks_up = "Z"


def _request_of(scene: bpy.types.Scene, index: int) -> SimulationRequest:
    """Return the request by the settings of the crowd `index`."""
    crowds = crowds_of(scene.crowd_lod)
    if not 0 <= index < len(crowds):
        raise CrowdError(
            f"There is no crowd {index}: the scene {scene.name} has {len(crowds)}, counted from 0."
        )
    crowd = crowds[index]
    set_lengths(scene)
    stored_values.check(crowd)
    check_counts(crowd.count)
    machine = machine_of(crowd)
    meters = scene_data.meters(scene)
    walls = _labels_in(machine, "Walls", crowd.wall_labels, "wall")
    goals = _labels_in(machine, "Goals", crowd.goal_labels, "exit")
    if not goals.any():
        raise CrowdError(
            f"Name the labels that agents walk to in Goals: the state machine has "
            f"{', '.join(machine.labels)}."
        )
    starts = (
        _labels_in(machine, "Spawn Labels", crowd.spawn_labels)
        if crowd.spawn_labels.strip()
        else machine.spawn
    )
    return SimulationRequest(
        world=_in_meters(world_of(crowd, machine), meters),
        walls=walls & ~goals,
        starts=starts & ~walls & ~goals,
        goals=goals,
        obstacles=_obstacles(crowd, meters),
        nearest=crowd.goal_choice == "NEAREST",
        count=crowd.count,
        seed=crowd.seed,
        seconds=crowd.simulated_seconds,
        rate=scene_data.frame_rate(scene),
    )


def _in_meters(world: LabelMap, meters: float) -> LabelMap:
    """Return the map, which is in units of `meters`, in meters, as JuPedSim has it."""
    return replace(world, area=Area(*(edge * meters for edge in astuple(world.area))))


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


def _obstacles(crowd, meters: float) -> np.ndarray:
    """Return `obstacles` of a SimulationRequest: the meshes' outlines at knee height.

    meters: in a unit of the scene.
    """
    if crowd.obstacles is None:
        return np.empty((0, 2, 2))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    cuts = [np.empty((0, 2, 2))]
    for item in crowd.obstacles.all_objects:
        if item.type == "MESH":
            mesh = mesh_data.world_mesh(item.evaluated_get(depsgraph))
            cuts.append(section(mesh.points, mesh.triangles, crowd.center[2] + KNEE / meters))
    return np.concatenate(cuts) * meters


def _saved(scene: bpy.types.Scene) -> str:
    return (
        "" if bpy.data.filepath else "Save the file first: the trajectories are written beside it"
    )


class CROWDLOD_OT_simulate(Stepwise, bpy.types.Operator):
    bl_description = (
        "Simulate people who walk to their goals, around walls and each other, and let the "
        "active crowd follow them"
    )
    bl_idname = "crowd_lod.simulate"
    bl_label = "Simulate with JuPedSim"
    needs = (_saved, needs.crowds)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        index = index_of_active(scene.crowd_lod)
        home = Path(bpy.data.filepath)
        name = bpy.path.clean_name(f"{home.stem}_{scene.name}" + (f"_{index + 1}" if index else ""))
        path = files.absolute(home.with_name(f"{name}.sqlite"))
        with files.staged_file(path) as part:
            said = yield from simulate_crowd(scene, index, part)
        follow(scene, index, f"//{path.name}")
        return f"{said} The trajectories are in {printable(path.name)}."


CLASSES = (CROWDLOD_OT_simulate,)
