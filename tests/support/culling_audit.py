"""Random cameras, and the culling of random spheres by them beside exact arithmetic."""

from dataclasses import dataclass

import numpy as np
from crowd_lod_extension.crowd_lod.culling.camera import Camera, referential, window
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.validation.exact_frustum import (
    depth_off,
    find_visible,
    scatter,
    standing_crowd,
)

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


def random_camera(random, lens):
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


def audit(lens, pairs, on_planes=0.0):
    """Return the verdict on `pairs` random pairs of camera and agent.

    lens: one of LENSES.
    on_planes: the part of the agents within roundings of a plane.
    """
    return sum(_audits(lens, pairs, np.random.default_rng(0), on_planes), CullingJudgment())


def _audits(lens, pairs, random, on_planes):
    while pairs > 0:
        camera = random_camera(random, lens)
        count = min(pairs, AGENTS)
        radius = 10.0 ** random.uniform(-3, 1.5, 8)
        group = random.integers(len(radius), size=count, dtype=np.uint8)
        yield judge_culling(
            camera, scatter(camera, radius[group], random, on_planes), radius, group
        )
        pairs -= count


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
    return CullingJudgment(
        pairs=len(points),
        visible=int(truly.sum()),
        survivors=int(visible.sum()),
        missed=int((truly & ~visible).sum()),
        surplus=int((visible & ~truly).sum()),
        grazing=int((visible & ~truly & doubtful).sum()),
        beside=beside,
        doubtful=int(doubtful.sum()),
        depth_error=0.0 if camera.kind == "PANO" else depth_off(camera, points, distance),
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
