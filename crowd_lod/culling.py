"""View-frustum culling: the radar test (chapter eqs 1.4 to 1.6, listing 1.2)."""

from collections.abc import Sequence

import numpy as np

from .agents import Crowd
from .camera import Camera, Planes, planes, stretch
from .errors import CrowdError

# Agents a block: its few float64 columns stay in the processor's cache.
BLOCK = 16_384
# Bound on the rounding of n . v - offset in float64, relative to |vx| + |vy| + |vz| + |offset| + |origin z| + reach, so
# that rounding never drops an agent. In units of u = eps / 2: p - c errs by 1 (z + centre, then - c: 2), the normal by 8
# (a difference, its norm, a division), the dot product by 3, offset and reach by 4 each, the bound's own sums by 4. That
# is 21; 32 leaves room for singular values, square roots and sheared cameras' inverses.
ROUNDING = 16 * np.finfo(np.float64).eps
# Metres. Products and squares of smaller numbers may lose all their bits to underflow.
TINY = 1e-150


def radar(
    crowd: Crowd,
    cameras: Camera | Sequence[Camera],
    centre: np.ndarray,
    radius: np.ndarray,
    margin: float | None = None,
    radial: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """(visible, distance): which agents any of the cameras may see, and how far away they are.

    cameras: one, or the eyes of one picture. centre, radius: (G,) float64, each group's bounding sphere: height of its
    centre above the feet, radius, metres. margin: None derives the chapter's widening from the sphere, which is then
    visible iff it lies in or touches all six planes (Delta = r / cos(fov / 2) at the sides, r at near and far); a number
    is the chapter's fixed Delta in metres, at the sides alone. A panoramic camera keeps all within its clip range and
    its cone; what its picture leaves out within the cone is kept as well.

    visible: (n,) bool. distance: (n,) float64, metres from the camera to the sphere's centre: v.Z along the view, or
    |v| with `radial` and for panoramic cameras; with several cameras the least, so that all show the finest LOD that
    one needs. Agents exactly on a plane are visible; those at NaN or infinity are not. Positions relative to the camera
    are formed in float64.
    """
    cameras = (cameras,) if isinstance(cameras, Camera) else tuple(cameras)
    frustums = [None if camera.kind == "PANO" else planes(camera) for camera in cameras]
    count = len(crowd)
    visible, distance = np.zeros(count, bool), np.full(count, np.inf)
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        for begin in range(0, count, BLOCK):
            block = slice(begin, begin + BLOCK)
            group = crowd.group[block]
            z, r = crowd.z[block] + centre[group], radius[group] if margin is None else 0.0
            for camera, frustum in zip(cameras, frustums, strict=True):
                v = crowd.x[block] - camera.origin[0], crowd.y[block] - camera.origin[1], z - camera.origin[2]
                depth = _dot(v, camera.Z)
                range_ = np.sqrt(_dot(v, v)) if radial or frustum is None or camera.turn else None
                reach = r + camera.pad
                if camera.turn:
                    reach = reach + camera.turn * (range_ + reach)
                slack = ROUNDING * (np.abs(v[0]) + np.abs(v[1]) + np.abs(v[2]) + np.abs(camera.origin[2]) + reach) + TINY
                if frustum is None:
                    inside = _in_cone(camera, v, depth, range_, reach + slack)
                else:
                    inside = _in_frustum(frustum, v, depth, reach + frustum.rounding * slack, margin)
                visible[block] |= inside & np.isfinite(slack)
                np.fmin(distance[block], range_ if radial or frustum is None else depth, out=distance[block])
    return visible, distance


def _in_frustum(frustum: Planes, v: tuple, depth: np.ndarray, bound: np.ndarray, margin: float | None) -> np.ndarray:
    """(b,) bool: spheres with their centres at v that reach no further than `bound` (b,) beyond any of the six planes.
    What lies before near or behind far, often the most, does not meet the sides."""
    near, far = frustum.offsets[4:] + ROUNDING * np.abs(frustum.offsets[4:])
    along = depth * frustum.fixed[5]
    inside = (along <= far + bound) & (along >= -near - bound)
    rest = np.flatnonzero(inside)
    v, bound = tuple(component[rest] for component in v), bound[rest]
    ok = np.ones(len(rest), bool)
    for normal, offset, fixed in zip(frustum.normals[:4], frustum.offsets, frustum.fixed, strict=False):
        ok &= _dot(v, normal) <= bound + (offset + ROUNDING * abs(offset) + (margin or 0.0) * fixed)
    inside[rest] = ok
    return inside


def _in_cone(camera: Camera, v: tuple, depth: np.ndarray, range_: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(b,) bool: spheres with their centres at v within the clip range and the cone of a panoramic camera.

    In the plane through the axis and v, the cone's side is the line at the angle `cone`, from which v lies
    |v| sin(angle - cone) = across cos(cone) - depth sin(cone) away.
    """
    inside = (range_ >= camera.near * (1 - ROUNDING) - reach) & (range_ <= camera.far * (1 + ROUNDING) + reach)
    if camera.cone < np.pi:
        across = np.sqrt(_dot(v, camera.X) ** 2 + _dot(v, camera.Y) ** 2)
        inside &= across * np.cos(camera.cone) - depth * np.sin(camera.cone) <= reach * stretch(camera)[1]
    return inside


def _dot(v: tuple, axis) -> np.ndarray:
    return v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]


def lost(crowd: Crowd) -> np.ndarray:
    """Indices (m,) of the agents that stand at NaN or infinity."""
    columns = (crowd.x, crowd.y, crowd.z)
    with np.errstate(invalid="ignore", over="ignore"):
        if np.isfinite(sum(column.sum() for column in columns)):  # the common case at the cost of three sums
            return np.empty(0, np.intp)
    return np.flatnonzero(~np.logical_and.reduce([np.isfinite(column) for column in columns]))


def refuse_lost(agents: np.ndarray, count: int) -> None:
    """CrowdError if `agents` (m,), of `count`, from `lost`, are any."""
    if len(agents):
        raise CrowdError(
            f"{len(agents):,} of {count:,} agents stand at NaN or infinity, the first is agent {agents[0]}: mend the points "
            "or the map they come from, or let Crowd LOD drop them."
        )
