"""The plaza's people filmed by a camera that flies into them, surveyed without Blender."""

import numpy as np
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.camera import Camera, window
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.shot.recording import begin_recording
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.sample_scenes import plaza_map

GROUPS = tuple(
    Group(name, center, radius, stride, 1.0, (5000, 800, 60), (10000, 1600, 120), (0, 0.01, 0.1))
    for name, center, radius, stride in (
        ("adult", 0.85, 0.978, 1.3),
        ("child", 0.6, 0.684, 0.9),
        ("heavy", 0.9, 1.024, 1.4),
    )
)
POLICY = LevelPolicy((0.0,) * 2, tolerance=1.0)


def cast_of_rigs():
    """The characters of the groups, all of which rigs move."""
    return Cast(np.zeros(len(GROUPS), np.intp))


def plaza_shot(agents, frames):
    """Return (the crowd's trajectory, its survey) of `frames`."""
    machine = load_preset("plaza")
    world = plaza_map.plan(machine)
    crowd = populate(agents, 7, len(GROUPS), machine, world)
    trajectory = Walk(crowd, machine, world, GROUPS, 1 / 24)
    cast = cast_of_rigs()
    gaits = trajectory.gaits
    first = cast.first(gaits)
    roles = cast.roles(gaits)
    recording = begin_recording(frames, frames, crowd.group, first, cast, roles)
    with recording:
        for f, time in enumerate(frames):
            frame = plan(trajectory, camera(f / len(frames)), POLICY, time)
            recording.append(frame)
    return trajectory, recording.make_survey()


def camera(way):
    """A camera at a part `way` of its flight: level, down from 30 m into the square."""
    origin = np.array([0.0, -70 + 40 * way, 30 - 25 * way])
    ahead = np.array([0.0, 1.0, -0.4 + 0.3 * way])
    Z = ahead / np.linalg.norm(ahead)
    X = np.array([1.0, 0.0, 0.0])
    pixels = 1920, 1080
    return Camera(
        "PERSP", origin, X, np.cross(X, Z), Z, window(1.0, "AUTO", pixels), 0.2, 500, pixels
    )
