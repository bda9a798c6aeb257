"""Audit of the culling: agents missed, agents kept for nothing.

The judge is validation/exact_frustum.py.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera, referential, window
from ..culling.frustum import ROUNDING
from ..culling.radar import radar
from .exact_frustum import depth_error, find_visible, gap, scatter

# name: kind of camera, range of log10 of the fitted side (slope or meters), largest lens shift
LENSES = {
    "telephoto": ("PERSP", (-3.0, -1.0), 0.1),
    "normal": ("PERSP", (-1.0, 0.5), 0.1),
    "wide angle": ("PERSP", (0.5, 2.0), 0.1),
    "shifted": ("PERSP", (-1.0, 1.0), 3.0),
    "orthographic": ("ORTHO", (-1.0, 3.0), 1.0),
    "panoramic": ("PANO", (0.0, 0.0), 0.0),
    "sheared": ("PERSP", (-1.0, 0.5), 0.1),
    # its rays may see beyond the planes, so the culling keeps more
    "sheared, Cycles": ("PERSP", (-1.0, 0.5), 0.1),
}
AGENTS = 1000  # of each random camera
EXACT_DEPTHS = 50  # agents a check whose distance is compared with exact arithmetic


@dataclass(frozen=True)
class Verdict:
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

    def __add__(self, other: "Verdict") -> "Verdict":
        sums = {
            name: getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__
        }
        return Verdict(**sums | {"depth_error": max(self.depth_error, other.depth_error)})


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
) -> Verdict:
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
    return Verdict(
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


def random_camera(random: np.random.Generator, lens: str) -> Camera:
    """Return a camera with the lens `lens` of LENSES at a random place and rotation.

    Some cameras are mirrored.
    """
    kind, (low, high), shift = LENSES[lens]
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0]  # a rotation, mirrored or not
    if lens.startswith("sheared"):
        matrix[:3, :3] = np.diag(random.uniform(0.5, 2, 3)) @ matrix[:3, :3]
    matrix[:3, 3] = random.normal(size=3) * 10.0 ** random.uniform(-1, 4)
    width, height = random.integers(10, 4000, size=2).tolist()
    pixels = width, height
    fit = ("AUTO", "HORIZONTAL", "VERTICAL")[random.integers(3)]
    aspect = tuple(random.uniform(0.5, 2, 2))
    shifts = tuple(random.uniform(-shift, shift, 2))
    shape = window(10.0 ** random.uniform(low, high), fit, pixels, aspect, shifts)
    near = 10.0 ** random.uniform(-2, 0)
    return Camera(
        kind,
        *referential(matrix),
        shape,
        near,
        near + 10.0 ** random.uniform(0.5, 3),
        pixels,
        rays=lens.endswith("Cycles"),
    )


def audit(lens: str, pairs: int, seed: int = 0, on_planes: float = 0.0) -> Verdict:
    """Return the verdict on `pairs` random pairs of camera and agent.

    lens: one of LENSES.
    on_planes: the part of the agents within roundings of a plane.
    """
    return sum(_audits(lens, pairs, np.random.default_rng(seed), on_planes), Verdict())


def _audits(
    lens: str, pairs: int, random: np.random.Generator, on_planes: float
) -> Iterator[Verdict]:
    while pairs > 0:
        camera = random_camera(random, lens)
        count = min(pairs, AGENTS)
        radius = 10.0 ** random.uniform(-3, 1.5, 8)
        group = random.integers(len(radius), size=count, dtype=np.uint8)
        yield judge_culling(
            camera, scatter(camera, radius[group], random, on_planes), radius, group
        )
        pairs -= count
