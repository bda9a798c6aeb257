"""Why an agent is culled, or does not have the finest LOD."""

from dataclasses import replace

import numpy as np

from ..culling.frustum import beyond_clips, frustum_of
from ..levels.assignment import assign, deviations, threshold_distances
from .frame import Frame
from .planned import HIDDEN, OVERRIDDEN

REASONS = (
    "near enough",
    "far away",
    "detail map",
    "clipped before the near plane",
    "clipped beyond the far plane",
    "outside the frustum",
    "finer LODs left out for memory",
    "shot plan",
    "override",
    "hidden by scenery",
    "not there at this time",
)
(
    NEAR_ENOUGH,
    DISTANCE,
    DETAIL_MAP,
    NEAR,
    FAR,
    BESIDE,
    LEFT_OUT,
    SHOT_PLAN,
    OVERRIDE,
    BEHIND_SCENERY,
    ABSENT,
) = range(len(REASONS))


def reasons(frame: Frame) -> np.ndarray:
    """Return for each agent of `frame` an index (n,) uint8 into REASONS.

    A culled agent lies before near or beyond far of the first camera by its sphere, or else beside
    the view. A LOD that the distance alone does not give comes from the detail map, stands in for a
    finer one that builds leave out (LevelPolicy.finest), or comes from the shot plan. An override
    of the shot plan is the reason wherever it pins the LOD of a visible agent, or hides the
    agent. An agent that is not there has no other reason, unless an override hides it.
    """
    crowd = frame.crowd
    policy = frame.policy
    spheres = frame.trajectory.spheres
    thresholds = frame.thresholds
    finest = 0
    if any(policy.finest):
        deviation = deviations(frame.trajectory.groups, policy)
        thresholds = threshold_distances(
            replace(policy, finest=()), frame.camera, spheres.radius, deviation
        )
        finest = np.array(policy.finest)[crowd.group]
    plain = assign(frame.distances, thresholds, crowd.group)
    painted = plain
    if frame.bias is not None:
        painted = assign(frame.distances, thresholds, crowd.group, frame.factors)
    reason = np.full(len(crowd), DISTANCE, np.uint8)
    reason[painted != plain] = DETAIL_MAP
    reason[painted < finest] = LEFT_OUT
    reason[frame.levels != np.maximum(painted, finest)] = SHOT_PLAN
    reason[frame.levels == 0] = NEAR_ENOUGH
    culled = np.flatnonzero(~frame.visible)
    reason[culled] = BESIDE
    depth = frame.depths[culled]
    reach = spheres.reach[crowd.group[culled]] if policy.margin is None else 0.0
    camera = frame.camera
    if camera.kind == "PANO":
        before, behind = depth < camera.near - reach, depth > camera.far + reach
    else:
        before, behind = beyond_clips(frustum_of(camera), depth, reach)
    reason[culled[before]] = NEAR
    reason[culled[behind]] = FAR
    if frame.hidden is not None:
        reason[frame.hidden] = BEHIND_SCENERY
    if crowd.present is not None:
        reason[~crowd.present] = ABSENT
    if frame.plan_row is not None:
        reason[
            (frame.plan_row & HIDDEN != 0) | (frame.visible & (frame.plan_row & OVERRIDDEN != 0))
        ] = OVERRIDE
    return reason
