"""The camera's motion while its shutter is open, for frames that the viewport rests on."""

import time as clock
from dataclasses import fields

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ..blender import frame_stepping, image_data, scene_cache, sidebars
from ..blender.cameras import read_shutter
from ..blender.guard import guard
from ..blender.image_data import LOOK_AGAIN

REST = 0.3  # seconds that a frame is shown before its shutter is read
# By scene: (key of the shutter to be read, the time in seconds when it was requested).
_requests: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)
# By scene: (key, read_shutter's answer).
_shutters: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)


def open_shutter(scene, time: float, eyes: tuple[Camera, ...]) -> tuple:
    """Return (key, read_shutter's answer); the answer is () while it is not known.

    key: all that the answer depends on, but the camera's motion at other times: an edit of that
    alone shows once the frame or the camera changes.
    Reading other times needs a temporary scene, which must not be made while Blender draws. So a
    timer reads them and redraws the viewport. The frame after that takes long (see
    frame_stepping.stage), so frames that pass quickly are shown without an open shutter.
    """
    render = scene.render
    if not render.use_motion_blur:
        return (), ()
    key = time, render.motion_blur_position, render.motion_blur_shutter, *map(values_of, eyes)
    last_key, samples = _shutters.get(scene.session_uid, ((), ()))
    if last_key == key:
        return key, samples
    if _requests.get(scene.session_uid, ((),))[0] != key:
        _requests[scene.session_uid] = key, clock.monotonic()
    if not bpy.app.timers.is_registered(read_shutters):
        bpy.app.timers.register(read_shutters)
    return key, ()


@guard
def read_shutters() -> float | None:
    """Timer: read the requested shutters; return seconds to the next call, or None if done.

    It waits while an animation plays or the frame has just changed, when the next frame would
    request its own.
    """
    if image_data.is_playing():
        return LOOK_AGAIN
    rest = (
        max((since for _, since in _requests.values()), default=-np.inf) + REST - clock.monotonic()
    )
    if rest > 0:
        return rest
    for scene in bpy.data.scenes:
        key, _ = _requests.pop(scene.session_uid, (None, None))
        if key is not None:
            try:
                # a scene of its own: the user's would lose edits that are not keyed yet
                with frame_stepping.stage() as at:
                    _shutters[scene.session_uid] = key, read_shutter(scene, key[0], at)
            except CrowdError:  # the next drawing shows the error
                _shutters[scene.session_uid] = key, ()
    _requests.clear()
    sidebars.redraw_viewports()
    return None


def values_of(camera: Camera) -> tuple:
    """Return all fields of the camera as values that can be compared."""
    values = (getattr(camera, field.name) for field in fields(camera))
    return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in values)
