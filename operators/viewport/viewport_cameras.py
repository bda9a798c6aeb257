"""The cameras that a viewport plans with: its view, and the scene's while its shutter is open."""

import time as clock
from dataclasses import fields

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera, Window, referential
from ...crowd_lod.errors import CrowdError
from ..blender import evaluation, image_data, scene_cache, sidebars
from ..blender.callbacks import guard
from ..blender.cameras import read_shutter
from ..blender.image_data import LOOK_AGAIN


def viewpoint(context) -> Camera:
    """Return the view of the region being drawn as a Camera."""
    space = context.space_data
    view = context.region_data
    region = context.region
    camera = space.camera if space.use_local_camera else context.scene.camera
    through = view.view_perspective == "CAMERA" and camera is not None and camera.type == "CAMERA"
    clips = camera.data if through else space
    return camera_of(
        np.array(view.view_matrix, np.float64),
        np.array(view.window_matrix, np.float64),
        (region.width, region.height),
        (clips.clip_start, clips.clip_end),
    )


def camera_of(
    view: np.ndarray, projection: np.ndarray, pixels: tuple[int, int], clip: tuple[float, float]
) -> Camera:
    """Return the Camera that has these matrices.

    view: (4, 4) float64, world to viewer's space.
    projection: (4, 4) float64, OpenGL's, perspective or orthographic.
    pixels: width and height of the picture.
    clip: near and far in meters, of a perspective view, since far cannot be recovered from a
        float32 matrix. An orthographic view begins behind the viewer in Blender, so both of its
        are taken from the matrix.
    """
    origin, X, Y, Z = referential(np.linalg.inv(view), "of the viewport")
    edges = np.array([-1.0, 1.0])
    if projection[3, 3] == 0:
        kind = "PERSP"
        near, far = clip
        (left, right), (bottom, top) = (
            (edges + projection[axis, 2]) / projection[axis, axis] for axis in (0, 1)
        )
    else:
        kind = "ORTHO"
        near, far = (projection[2, 3] - edges) / projection[2, 2]
        (left, right), (bottom, top) = (
            (edges - projection[axis, 3]) / projection[axis, axis] for axis in (0, 1)
        )
    window = Window(float(left), float(right), float(bottom), float(top))
    return Camera(kind, origin, X, Y, Z, window, float(near), float(far), pixels)


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
    evaluation.stage), so frames that pass quickly are shown without an open shutter.
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
                with evaluation.stage() as at:
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
