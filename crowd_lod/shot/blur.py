"""How wide motion and depth of field blur agents in the picture."""

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..frame.frame import Frame


def blur_of(frame: Frame, agents: np.ndarray) -> np.ndarray:
    """Return by how many pixels each of `agents` (m,) is blurred at least, (m,) float64.

    The larger of two widths: the way of the sphere's center over the picture while the shutter is
    open, and the circle of confusion of the sphere's sharpest part (Potmesil and Chakravarty 1981).
    The least of all eyes. 0 for panoramic cameras.
    """
    return np.minimum.reduce(
        [
            np.maximum(_moved(frame, agents, e), _unfocused(frame, agents, e))
            for e in range(len(frame.eyes))
        ]
    )


def _moved(frame: Frame, agents: np.ndarray, eye: int) -> np.ndarray:
    """Return the pixels that each agent's center moves while the shutter is open, (m,)."""
    if len(frame.shutter) < 2 or frame.eyes[eye].kind == "PANO":
        return np.zeros(len(agents))
    height = frame.trajectory.spheres.center
    ends = [
        _pixels(eyes[eye], frame.trajectory.at(time), height, agents)
        for time, eyes in (frame.shutter[0], frame.shutter[-1])
    ]
    return np.nan_to_num(np.hypot(*(ends[1] - ends[0])))


def _pixels(camera: Camera, crowd: Crowd, height: np.ndarray, agents: np.ndarray) -> np.ndarray:
    """Return where the centers of `agents` lie in the picture, (2, m) pixels; NaN behind the
    camera.
    """
    v = np.stack(crowd.places(height, agents, camera.origin))
    across = np.stack([camera.X @ v, camera.Y @ v])
    depth = camera.Z @ v
    if camera.kind == "PERSP":
        across = across / np.where(depth > camera.near, depth, np.nan)
    return camera.pixels_per_unit * across


def _unfocused(frame: Frame, agents: np.ndarray, eye: int) -> np.ndarray:
    """Return the diameter of the circle of confusion of each agent's sharpest part, (m,) pixels."""
    camera = frame.eyes[eye]
    spheres = frame.trajectory.spheres
    crowd = frame.crowd
    if camera.kind != "PERSP" or not camera.turn or len(frame.eyes) > 1:
        return np.zeros(len(agents))
    focus = camera.pad / camera.turn
    radius = spheres.radius[crowd.group[agents]]
    depth = camera.Z @ np.stack(crowd.places(spheres.center, agents, camera.origin))
    sharpest = np.clip(
        focus, np.maximum(depth - radius, camera.near), np.maximum(depth + radius, camera.near)
    )
    return 2 * camera.pixels_per_unit * camera.pad * np.abs(1 / sharpest - 1 / focus)
