"""The crowds of a scene that are simulated, and what their files rest on.

A file's name ends in a digest of that. So it tells by itself whether it is up to date, and an undo
finds the file of before.
"""

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import bpy

from ....crowd_lod.crowd.agents import Group
from ...blender import image_data, scene_data
from ...blender.provenance import text_digest
from ...settings.crowds import crowds_of
from ..machine import kept_meshes
from ..machine.scene_world import machine_text, names_in
from ..machine.tracks_source import tracks_path
from .spawn_source import places_digest, places_inputs

DIGITS = 12  # of a digest in the name of a file
SETTINGS = (
    *("count", "seed", "spawn_on", "goal_choice", "spawn_labels", "wall_labels"),
    *("people_a_minute", "walking_speed", "simulated_seconds"),
)


def simulated_crowds(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    """Return the crowds whose source is a simulation."""
    return [crowd for crowd in crowds_of(scene.crowd_lod) if crowd.source == "SIMULATION"]


def simulation_digest(scene: bpy.types.Scene) -> str:
    """Return a digest of what the scene's simulated crowds are simulated from; "" without any.

    How fast characters walk is left out: Populate measures them.
    """
    crowds = simulated_crowds(scene)
    if not crowds:
        return ""
    return text_digest(scene_data.meters(scene), *map(_inputs, crowds))


def file_digest(scene: bpy.types.Scene, groups: Sequence[Group]) -> str:
    """Return the end of the names of the files of the scene's simulation, as it is now.

    groups: the measured groups.
    """
    strides = [(group.name, group.stride, group.period, group.slot) for group in groups]
    walking = {crowd.walking_speed for crowd in simulated_crowds(scene)}
    return text_digest(simulation_digest(scene), "STRIDE" in walking and strides)[:DIGITS]


def file_name(crowd, digest: str) -> str:
    """Return the name of the file of a simulated crowd."""
    return f"{bpy.path.clean_name(crowd.name)}_{digest}.npz"


def is_simulated(crowds: Iterable, digest: str) -> bool:
    """Return whether each of the crowds has its file, of this digest."""
    paths = [tracks_path(crowd) if crowd.simulation_file else Path() for crowd in crowds]
    return all(path.stem.endswith(f"_{digest}") and path.exists() for path in paths)


def _inputs(crowd) -> tuple:
    goals = [
        (goal.label, goal.share, goal.is_exit, _shape(filter(None, [goal.object])))
        for goal in crowd.goals
    ]
    obstacles = () if crowd.obstacles is None else crowd.obstacles.all_objects
    images = crowd.map_image, crowd.areas_image if len(crowd.areas) else None
    return (
        *(getattr(crowd, name) for name in SETTINGS),
        (*crowd.center,),
        (*crowd.size,),
        sorted(names_in(crowd)),
        goals,
        _shape(obstacles),
        machine_text(crowd),
        *map(_pixels, images),
        places_digest(crowd) or places_inputs(crowd),
    )


def _shape(objects: Iterable[bpy.types.Object]) -> str:
    return kept_meshes.shape_digest([*objects])


def _pixels(image: bpy.types.Image | None) -> str:
    return "" if image is None else hashlib.sha256(image_data.read_values(image)).hexdigest()
