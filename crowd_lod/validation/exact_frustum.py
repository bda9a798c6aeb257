"""The judge of culling and LODs: spheres against a frustum in exact rational arithmetic.

It shares no formula with what it judges. float64 decides where its bound on rounding lets it.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction as F
from typing import TypeVar

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..culling.frustum import ROUNDING

Number = TypeVar("Number", F, float)
Vector = Sequence[float] | np.ndarray
DEPTHS = 50  # spheres whose distance is compared with exact arithmetic
LOOSE = 256 * float(np.finfo(np.float64).eps)  # ten times what float64 rounds, and more


def sees(camera: Camera, center: Vector, radius: float) -> bool:
    """Return whether a camera sees the sphere, without rounding.

    The answer is exact for the float64 numbers given. The sphere must lie in or touch all six
    planes, or the clip range of a panoramic camera.
    center: (3,) floats, world meters.
    radius: meters.
    """
    v = _from_camera(camera, center)
    near, far, r = _exact((camera.near, camera.far, radius))
    if camera.kind == "PANO":
        square = _dot(v, v)
        return square <= (far + r) ** 2 and (r >= near or square >= (near - r) ** 2)
    for normal, offset in _planes(camera, F):
        out = _dot(v, normal) - offset
        # out / |normal| <= r, without the root
        if out > 0 and out * out > r * r * _dot(normal, normal):
            return False
    return True


def _exact(values: Vector) -> list[F]:
    return [F(float(value)) for value in values]


def _from_camera(camera: Camera, center: Vector) -> list[F]:
    return [p - c for p, c in zip(_exact(center), _exact(camera.origin), strict=True)]


def _dot(a: Sequence[F], b: Sequence[F]) -> F:
    return sum((p * q for p, q in zip(a, b, strict=True)), F(0))


def _planes(camera: Camera, number: Callable[[float], Number]) -> list[tuple[list[Number], Number]]:
    """Return six (normal, offset), in the arithmetic of `number`.

    Inside is normal . v <= offset. Normals are not of unit length.
    """
    X, Y, Z = ([number(float(q)) for q in axis] for axis in (camera.X, camera.Y, camera.Z))
    w = camera.window
    planes = [([-z for z in Z], -number(float(camera.near))), (Z, number(float(camera.far)))]
    for axis, sign, side in ((X, 1, w.right), (X, -1, w.left), (Y, 1, w.top), (Y, -1, w.bottom)):
        edge = number(float(side))
        if camera.kind == "ORTHO":
            planes.append(([sign * q for q in axis], sign * edge))
        else:
            normal = [sign * (q - edge * z) for q, z in zip(axis, Z, strict=True)]
            planes.append((normal, number(0)))
    return planes


def find_visible(
    camera: Camera, centers: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (mask, doubtful), each (n,) bool: `sees` for many spheres.

    doubtful: spheres that float64 could not decide and rational arithmetic did.
    centers: (n, 3) world meters.
    radius: (n,) meters.
    """
    v = centers - camera.origin
    size = np.abs(v).sum(axis=1) + np.abs(camera.origin).sum()
    with np.errstate(over="ignore", under="ignore"):
        if camera.kind == "PANO":
            distance = np.linalg.norm(v, axis=1)
            scale = 1.0
            offsets = np.array([camera.near, camera.far])
            out = np.array([camera.near - distance, distance - camera.far]) - radius
        else:
            normals, offsets = map(np.array, zip(*_planes(camera, float), strict=True))
            w = camera.window
            slope = max(map(abs, (w.left, w.right, w.bottom, w.top))) * (camera.kind != "ORTHO")
            scale = np.abs([camera.X, camera.Y, camera.Z]).sum() * (1 + slope)
            lengths = np.linalg.norm(normals, axis=1)[:, None]
            out = normals @ v.T - offsets[:, None] - lengths * radius
        bound = LOOSE * (scale * (size + radius) + np.abs(offsets)[:, None]) + 1e-150
        mask = ~(out > bound).any(axis=0)
        doubtful = mask & (np.abs(out) <= bound).any(axis=0)
    for i in np.flatnonzero(doubtful):
        mask[i] = sees(camera, centers[i], radius[i])
    return mask, doubtful


def find_levels(camera: Camera, centers: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Return the LODs of agents by distance, (n,) uint8, without rounding.

    centers: (n, 3) world meters. Distances are along the view; from a panoramic camera.
    begin: (n, k) meters, where the agents' LODs 1 ... k begin.
    """
    v = centers - camera.origin
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(v, axis=1) if camera.kind == "PANO" else v @ camera.Z
        size = np.abs(v).sum(axis=1) + np.abs(camera.origin).sum()
        passed = distance[:, None] >= begin
        bound = LOOSE * (size[:, None] + np.abs(begin))
        close = (np.abs(distance[:, None] - begin) <= bound) & np.isfinite(begin)
    for agent, level in np.argwhere(close):
        passed[agent, level] = _reaches(camera, centers[agent], begin[agent, level])
    return passed.sum(axis=1).astype(np.uint8)


def _reaches(camera: Camera, center: np.ndarray, begin: float) -> bool:
    v = _from_camera(camera, center)
    least = F(float(begin))
    if camera.kind == "PANO":
        return least < 0 or _dot(v, v) >= least * least
    return _dot(v, _exact(camera.Z)) >= least


def depth_off(camera: Camera, centers: np.ndarray, distances: np.ndarray) -> float:
    """Return the largest error of distances v.Z, as a part of the bound that `assign` states.

    Of up to DEPTHS spheres, evenly taken, beside exact arithmetic but for the last rounding.

    centers: (n, 3) world meters.
    distances: (n,) meters, of the spheres' centers (levels/assignment.py).
    """
    worst = 0.0
    for i in range(0, len(centers), max(1, len(centers) // DEPTHS)):
        size = np.abs(centers[i] - camera.origin).sum() + abs(camera.origin[2])
        bound = ROUNDING * size * np.linalg.norm(camera.Z)
        exact = _dot(_from_camera(camera, centers[i]), _exact(camera.Z))
        worst = max(worst, float(abs(F(float(distances[i])) - exact)) / (bound or np.inf))
    return float(worst)


def scatter(
    camera: Camera, radius: np.ndarray, random: np.random.Generator, on_planes: float = 0.25
) -> np.ndarray:
    """Return random world points (n, 3) for spheres in, around and beside the view.

    radius: (n,) meters.
    on_planes: the part of the points within a few roundings of where the sphere touches a plane.
    """
    count = len(radius)
    w = camera.window
    depth = random.uniform(-0.2, 1.2, count) * camera.far
    close = random.random(count) < 0.3
    depth[close] = camera.near * 10.0 ** random.uniform(-1, 2, close.sum())
    if camera.kind == "PANO":
        way = random.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        touch = random.random(count) < on_planes
        outside = random.random(count) < 0.5
        depth[touch] = np.where(outside, camera.far + radius, camera.near - radius)[touch]
        return camera.origin + depth[:, None] * way
    at = np.ones(count) if camera.kind == "ORTHO" else np.abs(depth)
    right = random.uniform(1.5 * w.left - 0.5 * w.right, 1.5 * w.right - 0.5 * w.left, count) * at
    up = random.uniform(1.5 * w.bottom - 0.5 * w.top, 1.5 * w.top - 0.5 * w.bottom, count) * at
    frame = np.linalg.inv(np.array([camera.X, camera.Y, camera.Z]))
    v = np.stack([right, up, depth], axis=1) @ frame.T
    walls = _planes(camera, float)
    pick = np.where(random.random(count) < on_planes, random.integers(len(walls), size=count), -1)
    for k, (wall, offset) in enumerate(walls):
        normal = np.array(wall)
        on_plane = pick == k
        length = np.linalg.norm(normal)
        step = radius[on_plane] - (v[on_plane] @ normal - offset) / length
        v[on_plane] += (step * (1 + random.normal(size=on_plane.sum()) * 1e-16))[:, None] * (
            normal / length
        )
    return camera.origin + v


def standing_crowd(points: np.ndarray, group: np.ndarray | None = None) -> Crowd:
    """Return a crowd that stands at the points (n, 3).

    group: (n,) uint8; group 0 for all if None.
    """
    still = np.zeros(len(points), np.float32)
    none = np.zeros(len(points), np.uint8)
    x, y, z = np.ascontiguousarray(points.T, np.float64)
    return Crowd(x, y, z, still, none, none if group is None else group, none)
