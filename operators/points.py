"""What the overlay draws, as arrays: the agents as points, the camera's frustum and LOD ranges as lines."""

from dataclasses import dataclass

import numpy as np

from ..crowd_lod.agents import Group
from ..crowd_lod.camera import Camera, frustum_corners
from ..crowd_lod.frame import Frame
from .levels import TINTS

# Linear RGBA.
CULLED = (0.45, 0.45, 0.45, 0.6)
FRUSTUM = (0.9, 0.75, 0.0, 1.0)
CULLED_SIZE = 0.6  # of a visible agent's
WIDTH = 0.6  # of a point, in radii of the agent's sphere


@dataclass(frozen=True)
class Drawing:
    """One frame's points and lines, in metres relative to `origin`, (3,) float64 world metres, the camera's place:
    float32 holds them to a millimetre wherever in the world the shot plays.

    positions: (n, 3) float32, the agents' sphere centres: LOD 0 first, those culled last. colours: (n, 4) float32,
    linear RGBA. sizes: (n,) float32, relative to the largest character's. diameter: metres that size 1 stands for.
    lines: (m, 2, 3) float32, both ends; line_colours: (m, 2, 4) float32.
    """

    origin: np.ndarray
    positions: np.ndarray
    colours: np.ndarray
    sizes: np.ndarray
    diameter: float
    lines: np.ndarray
    line_colours: np.ndarray


def drawing(frame: Frame, groups: tuple[Group, ...]) -> Drawing:
    """The drawing of `frame`, whose crowd is of `groups`."""
    crowd, origin = frame.crowd, frame.camera.origin
    centre = np.array([g.centre for g in groups])
    radius = np.array([g.radius for g in groups])
    seen = len(frame.buckets.order)
    order = np.concatenate([frame.buckets.order, np.flatnonzero(~frame.visible)])
    group = crowd.group[order]

    positions = np.empty((len(order), 3), np.float32)
    positions[:, 0] = crowd.x[order] - origin[0]
    positions[:, 1] = crowd.y[order] - origin[1]
    positions[:, 2] = crowd.z[order] + centre[group] - origin[2]

    colours = np.empty((len(order), 4), np.float32)
    colours[:seen] = _opaque(np.array(TINTS, np.float32)[frame.levels[order[:seen]]])
    colours[seen:] = CULLED

    largest = float(radius.max()) or 1.0
    sizes = (radius / largest).astype(np.float32)[group]
    sizes[seen:] *= CULLED_SIZE

    lines, line_colours = frustum_lines(frame.camera, frame.begins)
    return Drawing(
        origin=origin,
        positions=positions,
        colours=colours,
        sizes=sizes,
        diameter=WIDTH * largest,
        lines=(lines - origin).astype(np.float32),
        line_colours=line_colours,
    )


def frustum_lines(camera: Camera, begins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(ends, colours) of the frustum's edges and of a rectangle where each LOD begins, in its tint; of several where it
    begins elsewhere for other groups.

    begins: (G, n - 1) metres, see levels.limits. ends: (m, 2, 3) float64, world metres; colours: (m, 2, 4) float32, linear RGBA. A panoramic camera has no frustum.
    """
    if camera.kind == "PANO":
        return np.empty((0, 2, 3)), np.empty((0, 2, 4), np.float32)
    near, far = frustum_corners(camera, camera.near), frustum_corners(camera, camera.far)
    ends = [np.stack([near, far], axis=1), _ring(near), _ring(far)]
    colours = [FRUSTUM] * 3
    for level, distances in enumerate(begins.T, start=1):
        for distance in np.unique(distances[(distances > camera.near) & (distances <= camera.far)]):
            ends.append(_ring(frustum_corners(camera, distance)))
            colours.append((*TINTS[level], 1.0))
    each = np.array(colours, np.float32)[:, None, None]
    return np.concatenate(ends), np.broadcast_to(each, (len(ends), 4, 2, 4)).reshape(-1, 2, 4)


def _ring(corners: np.ndarray) -> np.ndarray:
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _opaque(rgb: np.ndarray) -> np.ndarray:
    return np.concatenate([rgb, np.ones_like(rgb[:, :1])], axis=1)
