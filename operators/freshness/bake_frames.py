"""What a bake keeps of each of its frames: digests of its cameras and lights."""

from collections.abc import Iterable

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.frame.planned import numbers_of
from ...crowd_lod.frame.shadows import Surroundings
from ..blender import scene_data
from ..blender.cameras import read_cameras
from ..blender.provenance import read_inputs, text_digest
from ..scene.lights import read_surroundings

# Custom properties of a build's collection.
BAKED = "crowd_lod_baked"  # Rate and Opens (see nodes/baked.py), first and last frame
CAMERAS = "crowd_lod_cameras"  # of a bake: a digest of each frame's cameras
LIGHTS = "crowd_lod_lights"  # of a bake: a digest of each frame's lights


def is_bake(build: bpy.types.Collection | None) -> bool:
    """Return whether the build holds the points of its frames."""
    return build is not None and BAKED in build


def cameras_digest(cameras: Iterable[Camera]) -> str:
    """Return a hash of a frame's cameras."""
    return text_digest(numbers_of(tuple(cameras)).round(5).tolist())[:8]


def lights_digest(around: Surroundings) -> str:
    """Return a hash of a frame's lights and mirrors, in any order.

    How far an engine lets a light reach is left out: a proof in Cycles is of builds for all
    engines.
    """
    lamps = [
        (
            *(light.direction),
            light.size,
            light.angle,
            *(() if light.origin is None else light.origin),
        )
        for light in around.lights
    ]
    panes = [(*mirror.normal, *mirror.corners.ravel()) for mirror in around.mirrors]
    return text_digest(
        *(sorted(np.round(each, 4).tolist() for each in kind) for kind in (lamps, panes))
    )[:8]


def differing_in_frame(
    bake: bpy.types.Collection, number: int, cameras: str, lights: str
) -> list[str]:
    """Return what of the bake's frame `number` was other when it was baked.

    cameras, lights: their digests now; "" for one that is not known.
    """
    now = {CAMERAS: ("the camera", cameras), LIGHTS: ("the lights", lights)}
    return [
        name
        for key, (name, digest) in now.items()
        if digest and read_inputs(bake, key).get(str(number), digest) != digest
    ]


def differing_now(scene: bpy.types.Scene, bake: bpy.types.Collection) -> list[str]:
    """Return what of the scene's frame is other than when it was baked."""
    if scene.frame_subframe:
        return []
    depsgraph = scene.view_layers[0].depsgraph
    lights = ""
    # with motion blur the shutter would have to be looked through
    if not scene.render.use_motion_blur:
        around = read_surroundings(scene, depsgraph, scene_data.time_of(scene))
        lights = lights_digest(around)
    cameras = cameras_digest(read_cameras(scene, depsgraph))
    return differing_in_frame(bake, scene.frame_current, cameras, lights)
