"""Why an agent is culled, or has not the finest LOD."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..crowd.agents import Group
from ..culling.camera import Camera
from ..culling.radar import planes, radar
from ..levels.assignment import Bias, LevelPolicy, assign, limits
from .frame import Frame, deviations

REASONS = (
    "near enough",
    "far away",
    "detail map",
    "hysteresis",
    "clipped before the near plane",
    "clipped beyond the far plane",
    "outside the frustum",
    "finer LODs left out for memory",
)
NEAR_ENOUGH, DISTANCE, DETAIL_MAP, HYSTERESIS, NEAR, FAR, BESIDE, LEFT_OUT = range(len(REASONS))


def reasons(
    frame: Frame, groups: tuple[Group, ...], cameras: Sequence[Camera], policy: LevelPolicy, bias: Bias | None = None
) -> np.ndarray:
    """For each agent of `frame`, whose plan had the other arguments, an index (n,) uint8 into REASONS.

    A culled agent lies before near or beyond far of the first camera by its sphere, or else beside the view. A LOD that
    the distance alone does not give comes from the detail map, stands in for a finer one that builds leave out
    (LevelPolicy.finest), or comes from hysteresis.
    """
    crowd = frame.crowd
    centre, radius = (np.array([getattr(group, name) for group in groups]) for name in ("centre", "reach"))
    _, distance = radar(crowd, cameras, centre, radius, policy.margin, policy.metric == "RADIAL")
    begins, finest = frame.begins, 0
    if any(policy.finest):
        sphere = np.array([group.radius for group in groups])
        begins = limits(replace(policy, finest=()), cameras[0], sphere, deviations(groups, policy))
        finest = np.array(policy.finest)[crowd.group]
    plain = assign(distance, begins, crowd.group)
    painted = plain if bias is None else assign(distance, begins, crowd.group, bias.at(crowd.x, crowd.y))
    found = np.full(len(crowd), DISTANCE, np.uint8)
    found[painted != plain] = DETAIL_MAP
    found[painted < finest] = LEFT_OUT
    found[frame.levels != np.maximum(painted, finest)] = HYSTERESIS
    found[frame.levels == 0] = NEAR_ENOUGH
    culled = np.flatnonzero(~frame.visible)
    found[culled] = BESIDE
    camera, group = cameras[0], crowd.group[culled]
    v = np.stack([crowd.x[culled], crowd.y[culled], crowd.z[culled] + centre[group]], axis=1) - camera.origin
    if camera.kind == "PANO":
        along, near, far = np.linalg.norm(v, axis=1), camera.near, camera.far
    else:
        frustum = planes(camera)
        along, near, far = v @ frustum.normals[5], -frustum.offsets[4], frustum.offsets[5]
    reach = radius[group] if policy.margin is None else 0.0
    found[culled[along < near - reach]] = NEAR
    found[culled[along > far + reach]] = FAR
    return found
