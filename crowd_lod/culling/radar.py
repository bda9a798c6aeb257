"""View-frustum culling: the radar test (chapter eqs 1.4 to 1.6, listing 1.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from .camera import Camera
from .frustum import Frustum, dot, frustum_of, reach_of, spheres_in_cone, spheres_inside

# Agents a block: its few float64 columns stay in the processor's cache.
BLOCK = 16_384


@dataclass(frozen=True)
class RadarOptions:
    """How agents are tested.

    margin: None derives the chapter's widening from the sphere. The sphere is then visible iff it
        lies in or touches all six planes (Delta = r / cos(fov / 2) at the sides, r at near and
        far). A number is the chapter's fixed Delta in meters, at the sides alone.
    cull: whether to test the spheres; all are visible if not.
    measure: whether to measure distances; those not measured are inf.
    """

    margin: float | None = None
    cull: bool = True
    measure: bool = True


PLAIN = RadarOptions()


def radar(
    crowd: Crowd,
    cameras: Camera | Sequence[Camera],
    center: np.ndarray,
    radius: np.ndarray,
    options: RadarOptions = PLAIN,
    agents: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (visible, distance): which agents any camera may see, and how far away.

    cameras: one, or the eyes of one picture.
    center, radius: (G,) float64 meters, each group's bounding sphere: the height of its center
        above the feet, and its radius.
    agents: (m,) indices to test; None tests all. The results are then (m,).

    visible: (n,) bool. Agents exactly on a plane are visible; those at NaN or infinity are not. A
        panoramic camera keeps all within its clip range and its cone, also what its picture leaves
        out within the cone.
    distance: (n,) float64 meters from the camera to the sphere's center: v.Z along the view, or |v|
        for panoramic cameras. With several cameras it is the least, so that all show the finest LOD
        that one needs.

    Positions relative to the camera are computed in float64. For a camera without shear and shift
    the planes of `frustum_of` say what the chapter does, of z = v.Z, y = v.Y and x = v.X:

        near - r <= z <= far + r
        |y| <= h / 2 + r / cos(fov_y / 2)    with h = 2 z tan(fov_y / 2)
        |x| <= w / 2 + r / cos(fov_x / 2)    with w = h ratio
    """
    cameras = (cameras,) if isinstance(cameras, Camera) else tuple(cameras)
    count = len(crowd) if agents is None else len(agents)
    visible = np.full(count, not options.cull)
    distance = np.full(count, np.inf)
    views = [
        (camera, frustum_of(camera) if options.cull and camera.kind != "PANO" else None)
        for camera in cameras
    ]
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        for begin in range(0, count, BLOCK):
            block = slice(begin, begin + BLOCK)
            x, y, z, group = (
                column[block] if agents is None else column.take(agents[block])
                for column in (crowd.x, crowd.y, crowd.z, crowd.group)
            )
            # of a single group, two numbers
            high, own = (v if len(v) == 1 else v.take(group) for v in (center, radius))
            r = own if options.margin is None else 0.0
            places = x, y, z + high
            for camera, frustum in views:
                _look(camera, frustum, places, r, options, (visible[block], distance[block]))
    return visible, distance


def _look(
    camera: Camera,
    frustum: Frustum | None,
    places: tuple,
    r: np.ndarray | float,
    options: RadarOptions,
    results: tuple,
) -> None:
    """Add to `results`, (visible, distance) of a block of agents, what one camera sees.

    frustum: the camera's planes; None for a panoramic one, and where nobody is culled.
    places: x, y, z of the spheres' centers, each (b,).
    r: radius.
    """
    visible, distance = results
    v = tuple(place - origin for place, origin in zip(places, camera.origin, strict=True))
    depth = dot(v, camera.Z)
    ranged = camera.kind == "PANO"
    # |v|, where something follows from it
    away = np.sqrt(dot(v, v)) if ranged or camera.turn else depth
    if options.cull:
        reach, slack = reach_of(camera, v, away, r)
        if frustum is None:
            inside = spheres_in_cone(camera, v, depth, away, reach + slack)
        else:
            inside = spheres_inside(
                frustum, v, depth, reach + frustum.rounding * slack, options.margin
            )
        visible |= inside & np.isfinite(slack)
    if options.measure:
        np.fmin(distance, away if ranged else depth, out=distance)


def lost(crowd: Crowd) -> np.ndarray:
    """Return the indices (m,) of the agents at NaN or infinity."""
    columns = crowd.places()
    with np.errstate(invalid="ignore", over="ignore"):
        # the common case at the cost of three sums
        if np.isfinite(sum(column.sum() for column in columns)):
            return np.empty(0, np.intp)
    return np.flatnonzero(~np.logical_and.reduce([np.isfinite(column) for column in columns]))
