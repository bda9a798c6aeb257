"""The judge of the culling: sphere against frustum in exact rational arithmetic.

It shares no formula with the culling, and counts agents missed, and agents kept for nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction as F
from typing import TypeVar

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..culling.frustum import ROUNDING
from ..culling.radar import radar

Number = TypeVar("Number", F, float)


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


def depth_error(camera: Camera, center: Sequence[float] | np.ndarray, distance: float) -> float:
    """Return |distance - v.Z| in meters, exact but for the last rounding.

    center: (3,), the center of the sphere.
    """
    v = (F(float(p)) - F(float(c)) for p, c in zip(center, camera.origin, strict=True))
    return float(
        abs(F(float(distance)) - sum(p * F(float(q)) for p, q in zip(v, camera.Z, strict=True)))
    )


def gap(camera: Camera, centers: np.ndarray) -> np.ndarray:
    """Return distances (n,) float64 in meters from centers to the frustum's body.

    They are measured to the nearest of its six faces and twelve edges; 0 inside. A sphere may touch
    all six planes and still miss the body at an edge or corner.
    centers: (n, 3) world meters.
    """
    w = camera.window
    frame = np.linalg.inv(np.array([camera.X, camera.Y, camera.Z]))
    points = []
    for depth in (camera.near, camera.far):
        at = 1.0 if camera.kind == "ORTHO" else depth
        rim = ((w.left, w.bottom), (w.right, w.bottom), (w.right, w.top), (w.left, w.top))
        points += [frame @ (at * x, at * y, depth) for x, y in rim]
    ends = np.array(points)
    v = centers - camera.origin
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    edges = {tuple(sorted((f[i], f[(i + 1) % 4]))) for f in faces for i in range(4)}
    least = np.full(len(v), np.inf)
    inside = np.ones(len(v), bool)
    middle = ends.mean(axis=0)
    for a, b in edges:
        along = ends[b] - ends[a]
        part = ((v - ends[a]) @ along / max(along @ along, 1e-300)).clip(0, 1)
        least = np.minimum(least, np.linalg.norm(v - ends[a] - part[:, None] * along, axis=1))
    for face in faces:
        corners = ends[list(face)]
        normal = np.cross(corners[2] - corners[0], corners[3] - corners[1])
        if not normal.any():
            continue  # the near face of a camera that clips at 0
        normal /= np.linalg.norm(normal)
        normal *= -1 if normal @ (middle - corners[0]) > 0 else 1
        middle_face = corners.mean(axis=0)
        height = (v - middle_face) @ normal
        over = np.ones(len(v), bool)
        for i in range(4):
            side = np.cross(normal, corners[(i + 1) % 4] - corners[i])
            over &= ((v - corners[i]) @ side) * ((middle_face - corners[i]) @ side) >= 0
        inside &= height <= 0
        least = np.where(over & (height > 0), np.minimum(least, height), least)
    return np.where(inside, 0.0, least)


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


EXACT_DEPTHS = 50  # agents a check whose distance is compared with exact arithmetic


@dataclass(frozen=True)
class CullingJudgment:
    """The result of `judge_culling`.

    pairs: of camera and agent. All other counts are of these pairs.
    visible: truly visible, by exact planes.
    survivors: agents that the culling left.
    missed: visible and culled.
    surplus: left and not visible.
    grazing: part of the surplus, within roundings of a plane.
    beside: visible by the planes, but the sphere misses the frustum's body at an edge or corner.
    doubtful: pairs that only exact arithmetic could decide, not float64.
    depth_error: the largest error of a distance, as a part of the bound that `assign` states
        (levels/assignment.py).
    """

    pairs: int = 0
    visible: int = 0
    survivors: int = 0
    missed: int = 0
    surplus: int = 0
    grazing: int = 0
    beside: int = 0
    doubtful: int = 0
    depth_error: float = 0.0

    def __add__(self, other: "CullingJudgment") -> "CullingJudgment":
        sums = {
            name: getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__
        }
        return CullingJudgment(**sums | {"depth_error": max(self.depth_error, other.depth_error)})


def standing_crowd(points: np.ndarray, group: np.ndarray | None = None) -> Crowd:
    """Return a crowd that stands at the points (n, 3).

    group: (n,) uint8; group 0 for all if None.
    """
    still = np.zeros(len(points), np.float32)
    none = np.zeros(len(points), np.uint8)
    x, y, z = np.ascontiguousarray(points.T, np.float64)
    return Crowd(x, y, z, still, none, none if group is None else group, none)


def judge_culling(
    camera: Camera, points: np.ndarray, radius: np.ndarray, group: np.ndarray
) -> CullingJudgment:
    """Return the verdict on the culling of spheres of radius[group] at the points.

    points: (n, 3) world meters.
    radius: (G,) meters.
    group: (n,) uint8.
    """
    visible, distance = radar(standing_crowd(points, group), camera, np.zeros(len(radius)), radius)
    truly, doubtful = find_visible(camera, points, radius[group])
    beside = 0
    if camera.kind != "PANO":
        beside = int((gap(camera, points[truly]) > radius[group][truly]).sum())
    errors = [0.0]
    if camera.kind != "PANO":
        for i in range(0, len(points), max(1, len(points) // EXACT_DEPTHS)):
            bound = (
                ROUNDING
                * (np.abs(points[i] - camera.origin).sum() + abs(camera.origin[2]))
                * np.linalg.norm(camera.Z)
            )
            errors.append(depth_error(camera, points[i], distance[i]) / (bound or np.inf))
    return CullingJudgment(
        pairs=len(points),
        visible=int(truly.sum()),
        survivors=int(visible.sum()),
        missed=int((truly & ~visible).sum()),
        surplus=int((visible & ~truly).sum()),
        grazing=int((visible & ~truly & doubtful).sum()),
        beside=beside,
        doubtful=int(doubtful.sum()),
        depth_error=float(max(errors)),
    )
