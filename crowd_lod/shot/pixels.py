"""What agents measure in a frame in pixels: a meter there, their blur, and by how many their LODs
may be off.
"""

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..culling.radar import RadarOptions, radar
from ..frame.frame import Frame

DISTANCES = RadarOptions(cull=False)


def scale_of(frame: Frame, agents: np.ndarray) -> np.ndarray:
    """Return how many pixels a unit shows at most of each of `agents` (m,), (m,) float64.

    It is that of levels.assignment.shown, the most of all eyes. No part counts as nearer than the
    near clip.
    """
    camera = frame.camera
    spheres = frame.trajectory.spheres
    if camera.kind == "ORTHO":
        return np.full(len(agents), camera.pixels_per_unit)
    crowd = frame.crowd
    radius = spheres.radius[crowd.group[agents]]
    scale = np.zeros(len(agents))
    for eye in frame.eyes:
        _, distance = radar(crowd, eye, spheres.center, spheres.reach, DISTANCES, agents)
        nearest = np.maximum(distance - radius, max(eye.near, 1e-9))
        is_ahead = distance > -radius
        np.maximum(scale, eye.pixels_per_unit / nearest, out=scale, where=is_ahead)
    return scale


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


def errors_of(frame: Frame) -> np.ndarray | None:
    """Return the pixels by which each visible agent's LOD deviates at most, (m,) float64.

    They are in the order of `frame.buckets`. None if LODs are not measured.
    """
    return _errors_at(frame, frame.buckets.order, frame.buckets.levels)


def worst_error(frame: Frame) -> float | None:
    """Return the largest of `errors_of`, 0 if nobody is visible; None if LODs are not measured.

    Of a single flat picture only the nearest agent of each group and LOD is judged: of 100,000
    agents, 1 ms instead of 25.
    """
    agents = frame.buckets.order
    levels = frame.buckets.levels
    if len(frame.eyes) == 1 and frame.camera.kind != "PANO":
        nearest = _nearest(frame)
        agents = agents[nearest]
        levels = levels[nearest]
    errors = _errors_at(frame, agents, levels)
    return None if errors is None else float(errors.max(initial=0.0))


def _errors_at(frame: Frame, agents: np.ndarray, levels: np.ndarray) -> np.ndarray | None:
    """Return the pixels of `errors_of` of `agents` (m,) with the LODs `levels` (m,)."""
    groups = frame.trajectory.groups
    count = len(frame.buckets.counts)
    if not all(len(group.bounds) >= count for group in groups):
        return None
    bounds = np.array([group.bounds[:count] for group in groups], np.float64)
    return scale_of(frame, agents) * bounds[frame.crowd.group[agents], levels]


def _nearest(frame: Frame) -> list[int]:
    """Return where in the buckets' order the nearest agent of each group and LOD stands."""
    crowd = frame.crowd
    agents = frame.buckets.order
    ahead = frame.camera.Z
    depth = crowd.x[agents] * ahead[0] + crowd.y[agents] * ahead[1] + crowd.z[agents] * ahead[2]
    nearest = []
    for first, last in zip(frame.buckets.offsets, frame.buckets.offsets[1:], strict=False):
        group = crowd.group[agents[first:last]]
        for g in range(len(frame.trajectory.groups)):
            (members,) = np.nonzero(group == g)
            if len(members):
                nearest.append(int(first + members[np.argmin(depth[first:last][members])]))
    return nearest
