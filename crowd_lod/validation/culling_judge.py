"""Judge of the culling, by exact planes: agents missed, agents kept for nothing."""

from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from ..culling.camera import Camera
from ..culling.frustum import ROUNDING
from ..culling.radar import radar
from .exact_frustum import depth_error, find_visible, gap

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
