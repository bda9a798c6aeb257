"""View-frustum culling: the radar test (chapter eqs 1.4 to 1.6, listing 1.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd, runs
from ..crowd.leave_outs import FLAT, IN_ORDER, NOTHING, ONE_GROUP, LeftOut
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
# Which corners of a box, (3, 8), lie at its lower side along x, y and z.
CORNERS = np.indices((2, 2, 2), dtype=bool).reshape(3, 8)


@dataclass(frozen=True)
class RadarOptions:
    """How agents are tested.

    margin: None derives the chapter's widening from the sphere. The sphere is then visible iff it
        lies in or touches all six planes (Delta = r / cos(fov / 2) at the sides, r at near and
        far). A number is the chapter's fixed Delta in meters, at the sides alone.
    radial: measure |v| instead of v.Z.
    leave: what the crowd does not need, from leave_outs.needless.
    every: the answer for all agents, from `bounds`, if it is known.
    measure: whether to measure distances; those not measured are inf.
    """

    margin: float | None = None
    radial: bool = False
    leave: frozenset[LeftOut] = NOTHING
    every: bool | None = None
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
    agents: (m,) indices to test, group by group if the crowd is in order; None tests all. The
        results are then (m,).

    visible: (n,) bool. Agents exactly on a plane are visible; those at NaN or infinity are not. A
        panoramic camera keeps all within its clip range and its cone, also what its picture leaves
        out within the cone.
    distance: (n,) float64 meters from the camera to the sphere's center: v.Z along the view, or |v|
        with `radial` and for panoramic cameras. With several cameras it is the least, so that all
        show the finest LOD that one needs.

    Positions relative to the camera are computed in float64.
    """
    cameras = (cameras,) if isinstance(cameras, Camera) else tuple(cameras)
    count, leave = len(crowd) if agents is None else len(agents), options.leave
    visible, distance = np.full(count, bool(options.every)), np.full(count, np.inf)
    if not count or (options.every is not None and not options.measure):
        return visible, distance
    views = [(camera, None if camera.kind == "PANO" else planes(camera)) for camera in cameras]
    height = crowd.z[0] + center if FLAT in leave else None
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        groups = crowd.group if agents is None else crowd.group[agents]
        for block in _blocks(groups, leave):
            here = block if agents is None else agents[block]
            group = groups[block.start if leave & {ONE_GROUP, IN_ORDER} else block]
            z = crowd.z[here] + center[group] if height is None else height[group]
            r = radius[group] if options.margin is None else 0.0
            places = crowd.x[here], crowd.y[here], z
            for camera, frustum in views:
                _look(camera, frustum, places, r, options, (visible[block], distance[block]))
    return visible, distance


def _look(
    camera: Camera, frustum: Planes | None, places: tuple, r: np.ndarray | float, options: RadarOptions, found: tuple
) -> None:
    """Add to `found`, (visible, distance) of a block of agents, what one camera sees.

    frustum: the camera's planes; None for a panoramic one.
    places: x, y, z of the spheres' centers, each (b,) or one number.
    r: radius.
    """
    visible, distance = found
    v = tuple(place - origin for place, origin in zip(places, camera.origin, strict=True))
    depth, ranged = _dot(v, camera.Z), options.radial or frustum is None
    away = np.sqrt(_dot(v, v)) if ranged or camera.turn else depth  # |v|, where something follows from it
    if options.every is None:
        reach, slack = reach_of(camera, v, away, r)
        if frustum is None:
            inside = _in_cone(camera, v, depth, away, reach + slack)
        else:
            inside = _in_frustum(frustum, v, depth, reach + frustum.rounding * slack, options.margin)
        visible |= inside & np.isfinite(slack)
    if options.measure:
        np.fmin(distance, away if ranged else depth, out=distance)


def _blocks(group: np.ndarray, leave: frozenset[LeftOut]) -> list[slice]:
    """Return slices of agents, group (n,); of one group each if they are in order."""
    parts = runs(group) if IN_ORDER in leave else [(0, len(group))]
    return [slice(at, min(at + BLOCK, end)) for begin, end in parts for at in range(begin, end, BLOCK)]


@dataclass(frozen=True)
class Bounds:
    """What holds for all agents.

    every: whether `radar` keeps all (True), none (False), or this is not known (None).
    finite: whether no agent stands at NaN or infinity.
    nearest, farthest: meters, bounds of all distances.
    """

    every: bool | None = None
    finite: bool = False
    nearest: float = -np.inf
    farthest: float = np.inf


def bounds(
    crowd: Crowd,
    cameras: Sequence[Camera],
    center: np.ndarray,
    radius: np.ndarray,
    options: RadarOptions = PLAIN,
) -> Bounds:
    """Return what `radar` finds for all agents, from the box about them.

    The arguments are those of `radar`.

    Rounding keeps the order of numbers: x <= y gives fl(x) <= fl(y). So the box's corners (for |v|:
    its nearest point) bound each of the radar's terms, computed with the same operations in the
    same order, roundings included. The answer is the radar's to the bit.
    """
    if not len(crowd):
        return Bounds()
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        z = crowd.z[:1] if FLAT in options.leave else crowd.z
        low = np.array([crowd.x.min(), crowd.y.min(), z.min() + center.min()])
        high = np.array([crowd.x.max(), crowd.y.max(), z.max() + center.max()])
        if not np.isfinite([low, high]).all():
            return Bounds()
        r = (radius.min(), radius.max()) if options.margin is None else (0.0, 0.0)
        each = [_bounds(camera, low, high, r, options) for camera in cameras]
    answers = [one.every for one in each]
    return Bounds(
        every=True if True in answers else None if None in answers else False,
        finite=True,
        nearest=min(one.nearest for one in each),
        farthest=min(one.farthest for one in each),
    )


def _bounds(camera: Camera, low: np.ndarray, high: np.ndarray, r: tuple, options: RadarOptions) -> Bounds:
    """Return the Bounds for one camera of spheres in a box.

    low, high: (3,), the box of the spheres' centers.
    r: (least, most) radius.
    """
    low, high = low - camera.origin, high - camera.origin
    corners = tuple(np.where(CORNERS, low[:, None], high[:, None]))
    nearest = tuple(np.minimum(np.maximum(low, 0.0), high)[:, None])
    close, away = np.sqrt(_dot(nearest, nearest)), np.sqrt(_dot(corners, corners))
    (least, little), (most, much) = reach_of(camera, nearest, close, r[0]), reach_of(camera, corners, away, r[1])
    depth = _dot(corners, camera.Z)
    if camera.kind == "PANO":
        least, most = (least + little).min(), (most + much).max()
        begin, end = camera.near * (1 - ROUNDING), camera.far * (1 + ROUNDING)
        inside = camera.cone >= np.pi and close.min() >= begin - least and away.max() <= end + least
        outside = close.min() > end + most or away.max() < begin - most
    else:
        frustum = planes(camera)
        least, most = (least + frustum.rounding * little).min(), (most + frustum.rounding * much).max()
        *sides, near, far = frustum.limits(options.margin, ROUNDING)
        along = depth * frustum.fixed[5]
        beyond = [(_dot(corners, normal), side) for normal, side in zip(frustum.normals, sides, strict=False)]
        inside = along.max() <= far + least and along.min() >= -near - least
        inside = inside and all(d.max() <= least + side for d, side in beyond)
        outside = along.min() > far + most or along.max() < -near - most
        outside = outside or any(d.min() > most + side for d, side in beyond)
    every = None if not np.isfinite(much).all() else True if inside else False if outside else None
    if options.radial or camera.kind == "PANO":
        return Bounds(every, True, float(close.min()), float(away.max()))
    return Bounds(every, True, float(depth.min()), float(depth.max()))


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
