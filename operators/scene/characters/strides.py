"""How fast a character group's agents walk, and the strides of its actions that follow from it."""

from collections.abc import Iterator
from contextlib import suppress

import bpy
import numpy as np

from ....crowd_lod.crowd.strides import Cycle, Plays, how_it_plays
from ....crowd_lod.errors import CrowdError
from ...blender import scene_data
from ...blender.character_objects import group_of
from ...blender.performance import PlayedAction
from ...settings.crowds import crowds_of
from ..machine.scene_world import machine_of, names_in
from ..machine.tracks_source import file_inputs, tracks_of_crowd

# of people, m/s: mean, deviation, least and most (Weidmann 1993)
WALKING = 1.34, 0.26, 0.7, 2.0


def stride_of(
    scene: bpy.types.Scene, group: str, part: PlayedAction, given: float, feet: float, size: float
) -> tuple[float, Plays]:
    """Return the stride of what a character group plays as `part`, 0 if by time; and why.

    given: of a custom property, 0 without; feet: what its feet walk in a cycle.
    size: the diameter of its bounding sphere. All lengths are in units of the scene.
    """
    meters = scene_data.meters(scene)
    facing = -scene_data.rotation(scene.crowd_lod.forward)
    x, y = part.root.way
    seconds = (part.last - part.first) / scene_data.frame_rate(scene)
    plays = how_it_plays(
        given * meters,
        Cycle(seconds, (x * meters, y * meters), feet * meters, size * meters),
        (float(np.cos(facing)), float(np.sin(facing))),
        list(speeds_of(scene, group, part.name)),
    )
    lengths = {Plays.GIVEN: given, Plays.WAY: float(np.hypot(x, y)), Plays.FEET: feet}
    return lengths.get(plays, 0.0), plays


def speeds_of(scene: bpy.types.Scene, group: str, action: str) -> Iterator[float]:
    """Yield the speeds, m/s, at which a group's agents play an action; "" is their group's own.

    Points play by time at any speed. Of a file that cannot be read none are known.
    """
    meters = scene_data.meters(scene)
    for crowd in _crowds_with(scene, group):
        if crowd.source == "MACHINE":
            machine = machine_of(crowd)
            for s, name in enumerate(machine.actions):
                if name == action:
                    yield from (np.unique(np.hypot(*machine.velocity[s].T)) * meters).tolist()
        elif crowd.source == "SIMULATION" and action in ("", crowd.waiting_action):
            yield 0.0 if action else WALKING[0]
        elif crowd.source == "FILE" and not action:
            with suppress(CrowdError):  # where the file is read it is told
                tracks = tracks_of_crowd(crowd, scene_data.frame_rate(scene))
                yield from (tracks.paces * tracks.meters).tolist()


def _crowds_with(scene: bpy.types.Scene, group: str) -> list[bpy.types.PropertyGroup]:
    """Return the crowds that may have agents of the character group."""
    names = {group, group_of(group)}
    return [crowd for crowd in crowds_of(scene.crowd_lod) if names & (names_in(crowd) or {group})]


def speed_inputs(scene: bpy.types.Scene) -> list[tuple]:
    """Return what the speeds of the agents of each crowd follow from, and Forward."""
    inputs: list[tuple] = [(scene.crowd_lod.forward,)]
    for crowd in crowds_of(scene.crowd_lod):
        names = sorted(names_in(crowd))
        if crowd.source == "MACHINE":
            machine = machine_of(crowd)
            speeds = np.hypot(machine.velocity[..., 0], machine.velocity[..., 1])
            inputs.append((names, list(machine.actions), speeds.tolist()))
        elif crowd.source == "FILE":
            inputs.append((names, file_inputs(crowd)))
        elif crowd.source == "SIMULATION":
            inputs.append((names, crowd.source))
    return inputs
