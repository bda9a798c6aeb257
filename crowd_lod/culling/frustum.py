"""The frustum: the planes of what a camera sees, their rounding, and the spheres that they hold.

All that is culled asks it: spheres here, boxes in blocks.py, shadows and mirrors in volumes.py. The
GPU has the same planes (shaders/), the judge its own (validation/exact_frustum.py).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from .camera import Camera, stretch

# Bound on the rounding of n . v - offset in float64, relative to |vx| + |vy| + |vz| + |offset| +
# |origin z| + reach, so that rounding never drops an agent. In units of u = eps / 2: p - c errs by
# 1 (z + center, then - c: 2), the normal by 8 (a difference, its norm, a division), the dot product
# by 3, offset and reach by 4 each, the bound's own sums by 4. That is 21; 32 leaves room for
# singular values, square roots and sheared cameras' inverses.
ROUNDING = 16 * np.finfo(np.float64).eps
# Meters. Products and squares of smaller numbers may lose all their bits to underflow.
TINY = 1e-150


@dataclass(frozen=True)
class Frustum:
    """A space with flat sides: what a camera sees, directly or in a mirror.

    It holds the points p with normals . (p - origin) <= offsets, moved outward by `pad` meters and
    by `turn` meters per meter of distance from the origin (see Camera).

    origin: (3,) float64 meters.
    normals: (k, 3) float64, unit vectors in world space, outward.
    offsets: (k,) meters.
    fixed: (k,), meters along the normal per meter of v.X, v.Y (the chapter's fixed Delta) or v.Z,
        where v = p - origin; only of a camera's own frustum.
    rounding: how much larger than 1 the terms were that canceled in a normal. It is the factor by
        which the normal's rounding may exceed that of a unit vector.
    """

    origin: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    pad: float = 0.0
    turn: float = 0.0
    fixed: np.ndarray = field(default_factory=lambda: np.empty(0))
    rounding: float = 1.0

    def limits(self, margin: float | None = None, rounding: float = 0.0) -> np.ndarray:
        """Return (k,) meters: the offsets, farther out by the part `rounding` of each.

        At the sides of a camera they are also farther out by the chapter's fixed Delta, `margin`
        meters, if there is one.
        """
        limits = self.offsets + rounding * np.abs(self.offsets)
        if margin:
            limits[:4] += margin * self.fixed[:4]
        return limits


def frustum_of(camera: Camera) -> Frustum:
    """Return the frustum of a PERSP or ORTHO camera (chapter eqs 1.4 to 1.6).

    Its planes are right, left, top, bottom, near, far.

    |v.X| <= w / 2 with w = 2 (v.Z) tan(fov / 2) is (X - t Z) . v <= 0 with the slope t = tan(fov /
    2) of the window's side. Divided by its length sqrt(1 + t^2), the chapter's 1 / cos(fov / 2), it
    is the distance from the plane in meters. It stays finite as fov goes to 180 degrees, and a
    sphere touches the plane iff it is at most r.

    Cycles begins and ends a sheared camera's rays at near and far times a factor that depends on
    the direction. With `camera.rays` the two planes are moved apart by the bound of that factor,
    `stretch`.
    """
    w = camera.visible_window
    X = camera.X
    Y = camera.Y
    Z = camera.Z
    edges = ((X, w.right), (-X, -w.left), (Y, w.top), (-Y, -w.bottom))
    slopes = [0.0 if camera.kind == "ORTHO" else edge for _, edge in edges]
    least, most = stretch(camera) if camera.rays and camera.kind != "ORTHO" else (1.0, 1.0)
    rows = np.array(
        [axis - slope * Z for (axis, _), slope in zip(edges, slopes, strict=True)] + [-Z, Z]
    )
    offsets = [edge - slope for (_, edge), slope in zip(edges, slopes, strict=True)]
    lengths = np.sqrt((rows * rows).sum(axis=1))
    across, up, along = (math.sqrt(axis @ axis) for axis in (X, Y, Z))
    terms = [
        axis + abs(slope) * along
        for axis, slope in zip((across, across, up, up), slopes, strict=True)
    ]
    return Frustum(
        origin=camera.origin,
        normals=rows / lengths[:, None],
        offsets=np.array([*offsets, -camera.near * least, camera.far * most]) / lengths,
        pad=camera.pad,
        turn=camera.turn,
        fixed=1 / lengths,
        rounding=float((terms / lengths[:4]).max()),
    )


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


def spheres_inside(
    frustum: Frustum, v: tuple, depth: np.ndarray, bound: np.ndarray, margin: float | None
) -> np.ndarray:
    """Return which spheres are inside all six planes or touch them, (b,) bool.

    v: the centers, relative to the camera.
    depth: v.Z.
    bound: (b,) meters by which a center may lie beyond a plane. The sides are tested only for
        spheres between near and far.
    """
    sides = frustum.limits(margin, ROUNDING)[:4]
    before, behind = beyond_clips(frustum, depth, bound)
    inside = ~(before | behind)
    rest = np.flatnonzero(inside)
    v = tuple(component.take(rest) for component in v)
    bound = bound.take(rest)
    is_between = np.ones(len(rest), bool)
    for normal, side in zip(frustum.normals[:4], sides, strict=True):
        is_between &= dot(v, normal) <= bound + side
    inside[rest] = is_between
    return inside


def beyond_clips(
    frustum: Frustum, depth: np.ndarray, bound: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Return which spheres lie before the near plane, and which behind the far one, (b,) bool each.

    depth: v.Z of their centers.
    bound: meters by which a center may lie beyond a plane.
    """
    near, far = frustum.limits(rounding=ROUNDING)[4:]
    along = depth * frustum.fixed[5]
    return along < -near - bound, along > far + bound


def spheres_in_cone(
    camera: Camera, v: tuple, depth: np.ndarray, away: np.ndarray, reach: np.ndarray
) -> np.ndarray:
    """Return which spheres a PANO camera's clip range and cone hold, (b,) bool.

    In the plane through the axis and v, the cone's side is the line at the angle `cone`, from which
    v lies |v| sin(angle - cone) = across cos(cone) - depth sin(cone) away.
    """
    inside = (away >= camera.near * (1 - ROUNDING) - reach) & (
        away <= camera.far * (1 + ROUNDING) + reach
    )
    if camera.cone < np.pi:
        across = np.sqrt(dot(v, camera.X) ** 2 + dot(v, camera.Y) ** 2)
        inside &= (
            across * np.cos(camera.cone) - depth * np.sin(camera.cone) <= reach * stretch(camera)[1]
        )
    return inside


def dot(v: tuple, axis: tuple | np.ndarray) -> np.ndarray:
    """Return v . axis, each in the same order of operations, whatever their shapes."""
    return v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]


def spheres_swept_through(
    frustum: Frustum,
    points: np.ndarray,
    radius: np.ndarray,
    way: np.ndarray,
    grow: np.ndarray | float,
    ends: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Return whether spheres that move and grow with t >= 0 touch all planes, (n,).

    At t a sphere is at points + t way, and its radius is radius + t grow. Returns bool.

    way: (3,) with grow a number, or (n, 3) with grow (n,).
    ends: one more condition, ends[0] + t ends[1] <= 0.
    """
    v = points - frustum.origin
    size = np.linalg.norm(v, axis=1)
    speed = np.linalg.norm(way, axis=-1)
    reach = radius + frustum.pad
    growth = grow
    if frustum.turn:
        reach = reach + frustum.turn * (size + reach)
        growth = growth + frustum.turn * (speed + growth)
    reach = reach + ROUNDING * (4 * size + np.linalg.norm(frustum.origin) + reach) + TINY
    growth = growth + ROUNDING * (4 * speed + growth)
    offsets = frustum.offsets + ROUNDING * np.abs(frustum.offsets)
    if isinstance(growth, np.ndarray):  # all planes at once: (k, n)
        at = _along(frustum.normals, v) - offsets[:, None] - reach
        rate = _along(frustum.normals, way) - growth
        if ends is not None:
            at = np.concatenate([at, (ends[0] - ROUNDING * size)[None]])
            rate = np.concatenate([rate, (ends[1] - ROUNDING * speed)[None]])
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = -at / rate
        low = np.where(rate < 0, turn, 0.0).max(axis=0, initial=0.0)
        high = np.where(rate > 0, turn, np.inf).min(axis=0, initial=np.inf)
        return (low <= high * (1 + ROUNDING)) & ~((rate == 0) & (at > 0)).any(axis=0)
    low = np.zeros(len(v))
    high = np.full(len(v), np.inf)
    for normal, offset in zip(frustum.normals, offsets, strict=True):
        at = v @ normal - offset - reach
        rate = way @ normal - growth
        if rate < 0:
            low = np.maximum(low, at / -rate)
        elif rate > 0:
            high = np.minimum(high, at / -rate)
        else:
            high[at > 0] = -1
    return low <= high * (1 + ROUNDING)


def _along(normals: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Return how far the vectors `ways` (n, 3) go along the normals (k, 3), (k, n)."""
    x, y, z = ways.T
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z
