"""The plan of a frame of the scene's crowd, with the LODs of its shot plan."""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.shadows import Surroundings, surround
from ..blender import scene_data
from ..blender.cameras import read_cameras, read_shutter
from .scene_crowd import SceneCrowd
from .shot_reference import use_of


@dataclass(frozen=True)
class SceneMoment:
    """What of the scene a frame's plan depends on, besides the crowd.

    time: frames of the animation (see scene_data.time_of).
    eyes: the cameras that film it.
    around: lights and mirrors; with them, unseen agents that still matter are found, too.
    shutter: with motion blur, times and cameras of the open shutter (see cameras.read_shutter).
    """

    time: float
    eyes: Sequence[Camera]
    around: Surroundings | None = None
    shutter: Sequence[tuple[float, Sequence[Camera]]] = ()


def moment_now(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    around: Surroundings | None = None,
) -> SceneMoment:
    """Return the present moment of `scene`; its cameras are as `depsgraph` has them."""
    time = scene_data.time_of(scene)
    return SceneMoment(time, read_cameras(scene, depsgraph), around, read_shutter(scene, time))


def frame_of(crowd: SceneCrowd, moment: SceneMoment) -> Frame:
    """Return the plan of the crowd, with the LODs of the scene's shot plan if it has one."""
    use = use_of(crowd, moment.time, moment.eyes)
    # hidden agents cast no shadow, so overrides come last
    return use.applied(frame_by_policy(crowd, moment))


def frame_by_policy(crowd: SceneCrowd, moment: SceneMoment) -> Frame:
    """Return the plan of the crowd as of a scene without a shot plan and overrides.

    It reads nothing from the scene.
    """
    frame = plan(
        crowd.trajectory, moment.eyes, crowd.policy, moment.time, moment.shutter, crowd.bias
    )
    return frame if moment.around is None else surround(frame, moment.around)
