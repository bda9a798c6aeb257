"""View-frustum culling: the radar test (chapter eqs 1.4 to 1.6, listing 1.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from ..errors import CrowdError
from ..format import counted
from .camera import Camera, Planes, planes, stretch

# Agents a block: its few float64 columns stay in the processor's cache.
BLOCK = 16_384
# Bound on the rounding of n . v - offset in float64, relative to |vx| + |vy| + |vz| + |offset| +
# |origin z| + reach, so that rounding never drops an agent. In units of u = eps / 2: p - c errs by
# 1 (z + center, then - c: 2), the normal by 8 (a difference, its norm, a division), the dot product
# by 3, offset and reach by 4 each, the bound's own sums by 4. That is 21; 32 leaves room for
# singular values, square roots and sheared cameras' inverses.
ROUNDING = 16 * np.finfo(np.float64).eps
# Meters. Products and squares of smaller numbers may lose all their bits to underflow.
TINY = 1e-150


@dataclass(frozen=True)
class RadarOptions:
    """How agents are tested.

    margin: None derives the chapter's widening from the sphere. The sphere is then visible iff it
        lies in or touches all six planes (Delta = r / cos(fov / 2) at the sides, r at near and
        far). A number is the chapter's fixed Delta in meters, at the sides alone.
    radial: measure |v| instead of v.Z.
    cull: whether to test the spheres; all are visible if not.
    measure: whether to measure distances; those not measured are inf.
    """

    margin: float | None = None
    radial: bool = False
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
        with `radial` and for panoramic cameras. With several cameras it is the least, so that all
        show the finest LOD that one needs.

    Positions relative to the camera are computed in float64.
    """
    cameras = (cameras,) if isinstance(cameras, Camera) else tuple(cameras)
    count = len(crowd) if agents is None else len(agents)
    visible, distance = np.full(count, not options.cull), np.full(count, np.inf)
    views = [(camera, None if camera.kind == "PANO" else planes(camera)) for camera in cameras]
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        for begin in range(0, count, BLOCK):
            block = slice(begin, begin + BLOCK)
            here = block if agents is None else agents[block]
            group = crowd.group[here]
            r = radius[group] if options.margin is None else 0.0
            places = crowd.x[here], crowd.y[here], crowd.z[here] + center[group]
            for camera, frustum in views:
                _look(camera, frustum, places, r, options, (visible[block], distance[block]))
    return visible, distance


def _look(
    camera: Camera, frustum: Planes | None, places: tuple, r: np.ndarray | float, options: RadarOptions, found: tuple
) -> None:
    """Add to `found`, (visible, distance) of a block of agents, what one camera sees.

    frustum: the camera's planes; None for a panoramic one.
    places: x, y, z of the spheres' centers, each (b,).
    r: radius.
    """
    visible, distance = found
    v = tuple(place - origin for place, origin in zip(places, camera.origin, strict=True))
    depth, ranged = _dot(v, camera.Z), options.radial or frustum is None
    away = np.sqrt(_dot(v, v)) if ranged or camera.turn else depth  # |v|, where something follows from it
    if options.cull:
        reach, slack = reach_of(camera, v, away, r)
        if frustum is None:
            inside = _in_cone(camera, v, depth, away, reach + slack)
        else:
            inside = _in_frustum(frustum, v, depth, reach + frustum.rounding * slack, options.margin)
        visible |= inside & np.isfinite(slack)
    if options.measure:
        np.fmin(distance, away if ranged else depth, out=distance)


def reach_of(camera: Camera, v: tuple, away: np.ndarray, r: np.ndarray | float) -> tuple:
    """Return (the reach of spheres beyond their centers, its rounding), meters.

    r: radius.
    v: the centers, relative to the camera.
    away: (b,) |v|, for a camera with a `turn`.
    """
    reach = r + camera.pad
    size = np.abs(v[0]) + np.abs(v[1]) + np.abs(v[2])
    if camera.grain:
        reach = reach + camera.grain * (size + np.abs(camera.origin).sum())
    if camera.turn:
        reach = reach + camera.turn * (away + reach)
    return reach, ROUNDING * (size + np.abs(camera.origin[2]) + reach) + TINY


def _in_frustum(frustum: Planes, v: tuple, depth: np.ndarray, bound: np.ndarray, margin: float | None) -> np.ndarray:
    """Return which spheres are inside all six planes or touch them, (b,) bool.

    v: the centers, relative to the camera.
    depth: v.Z.
    bound: (b,) meters by which a center may lie beyond a plane. The sides are tested only for
        spheres between near and far.
    """
    *sides, near, far = frustum.limits(margin, ROUNDING)
    along = depth * frustum.fixed[5]
    inside = (along <= far + bound) & (along >= -near - bound)
    rest = np.flatnonzero(inside)
    v, bound = tuple(component[rest] if np.ndim(component) else component for component in v), bound[rest]
    ok = np.ones(len(rest), bool)
    for normal, side in zip(frustum.normals, sides, strict=False):
        ok &= _dot(v, normal) <= bound + side
    inside[rest] = ok
    return inside


def _in_cone(camera: Camera, v: tuple, depth: np.ndarray, away: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres a PANO camera's clip range and cone hold, (b,) bool.

    In the plane through the axis and v, the cone's side is the line at the angle `cone`, from which
    v lies |v| sin(angle - cone) = across cos(cone) - depth sin(cone) away.
    """
    inside = (away >= camera.near * (1 - ROUNDING) - reach) & (away <= camera.far * (1 + ROUNDING) + reach)
    if camera.cone < np.pi:
        across = np.sqrt(_dot(v, camera.X) ** 2 + _dot(v, camera.Y) ** 2)
        inside &= across * np.cos(camera.cone) - depth * np.sin(camera.cone) <= reach * stretch(camera)[1]
    return inside


def _dot(v: tuple, axis: tuple | np.ndarray) -> np.ndarray:
    return v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]


def lost(crowd: Crowd) -> np.ndarray:
    """Return the indices (m,) of the agents at NaN or infinity."""
    columns = crowd.places()
    with np.errstate(invalid="ignore", over="ignore"):
        # the common case at the cost of three sums
        if np.isfinite(sum(column.sum() for column in columns)):
            return np.empty(0, np.intp)
    return np.flatnonzero(~np.logical_and.reduce([np.isfinite(column) for column in columns]))


def refuse_lost(agents: np.ndarray, count: int) -> None:
    """Raise CrowdError if there are `agents` (m,), from `lost`; count: all agents."""
    if len(agents):
        raise CrowdError(
            f"{len(agents):,} of {counted(count, 'agent')} {'stands' if len(agents) == 1 else 'stand'} at NaN or infinity, the first is "
            f"agent {agents[0]}: fix the points or the map that they come from, or turn on Drop Lost Agents."
        )
