"""The judge of the culling: sphere against frustum in exact rational arithmetic.

It shares no formula with the culling.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction as F
from typing import TypeVar

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..culling.frustum import ROUNDING

Number = TypeVar("Number", F, float)
DEPTHS = 50  # spheres whose distance is compared with exact arithmetic


def sees(camera: Camera, center: Sequence[float] | np.ndarray, radius: float) -> bool:
    """Return whether a pinhole camera sees the sphere, without rounding.

    The answer is exact for the float64 numbers given. The sphere must lie in or touch all six
    planes, or the clip range of a panoramic camera.
    center: (3,) floats, world meters.
    radius: meters.
    """
    v = [F(float(p)) - F(float(c)) for p, c in zip(center, camera.origin, strict=True)]
    r = F(float(radius))
    near = F(float(camera.near))
    far = F(float(camera.far))
    if camera.kind == "PANO":
        square = sum(p * p for p in v)
        return square <= (far + r) ** 2 and (r >= near or square >= (near - r) ** 2)
    for normal, offset in _planes(camera, F):
        out = sum(p * q for p, q in zip(v, normal, strict=True)) - offset
        # out / |normal| <= r, without the root
        if out > 0 and out * out > r * r * sum(q * q for q in normal):
            return False
    return True


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
            planes.append(
                ([sign * (q - edge * z) for q, z in zip(axis, Z, strict=True)], number(0))
            )
    return planes


def find_visible(
    camera: Camera, centers: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (mask, doubtful), each (n,) bool: `sees` for many spheres.

    doubtful: spheres that float64 could not decide and rational arithmetic did. Each plane is
        tested in float64 with a bound on all rounding that is wide by a factor of 10 and more.
    centers: (n, 3) world meters.
    radius: (n,) meters.
    """
    v = centers - camera.origin
    size = np.abs(v).sum(axis=1) + np.abs(camera.origin).sum()
    loose = 256 * np.finfo(np.float64).eps
    no = np.zeros(len(v), bool)
    maybe = np.zeros(len(v), bool)
    # outside by, the scale and the offset that round
    tests: list[tuple[np.ndarray, float, float]] = []
    with np.errstate(over="ignore", under="ignore"):
        if camera.kind == "PANO":
            range_ = np.linalg.norm(v, axis=1)
            tests += [
                (camera.near - range_ - radius, 1.0, camera.near),
                (range_ - camera.far - radius, 1.0, camera.far),
            ]
        else:
            axes = np.abs([camera.X, camera.Y, camera.Z]).sum()
            for normal, offset in _planes(camera, float):
                w = camera.window
                scale = axes * (
                    1 + max(map(abs, (w.left, w.right, w.bottom, w.top))) * (camera.kind != "ORTHO")
                )
                tests.append(
                    (
                        v @ np.array(normal) - offset - radius * np.linalg.norm(normal),
                        scale,
                        abs(offset),
                    )
                )
        for out, scale, offset in tests:
            bound = loose * (scale * (size + radius) + offset) + 1e-150
            no |= out > bound
            maybe |= np.abs(out) <= bound
    mask = ~no
    doubtful = maybe & ~no
    for i in np.flatnonzero(doubtful):
        mask[i] = sees(camera, centers[i], radius[i])
    return mask, doubtful


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
        v = (F(float(p)) - F(float(c)) for p, c in zip(centers[i], camera.origin, strict=True))
        exact = sum(p * F(float(q)) for p, q in zip(v, camera.Z, strict=True))
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
