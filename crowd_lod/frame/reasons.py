"""Why an agent is culled, or does not have the finest LOD."""

from dataclasses import replace
from enum import IntEnum

import numpy as np

from ..culling.frustum import beyond_clips, frustum_of
from ..levels.assignment import assign, deviations, threshold_distances
from .frame import Frame
from .planned import HIDDEN, OVERRIDDEN


class Reason(IntEnum):
    """Why an agent is culled, or has its LOD."""

    NEAR_ENOUGH = 0
    DISTANCE = 1
    DETAIL_MAP = 2
    NEAR = 3
    FAR = 4
    BESIDE = 5
    LEFT_OUT = 6
    SHOT_PLAN = 7
    OVERRIDE = 8
    BEHIND_SCENERY = 9
    ABSENT = 10


REASONS = {
    Reason.NEAR_ENOUGH: "near enough",
    Reason.DISTANCE: "far away",
    Reason.DETAIL_MAP: "detail map",
    Reason.NEAR: "clipped before the near plane",
    Reason.FAR: "clipped beyond the far plane",
    Reason.BESIDE: "outside the frustum",
    Reason.LEFT_OUT: "finer LODs left out for memory",
    Reason.SHOT_PLAN: "shot plan",
    Reason.OVERRIDE: "override",
    Reason.BEHIND_SCENERY: "hidden by scenery",
    Reason.ABSENT: "not there at this time",
}


def reasons(frame: Frame) -> np.ndarray:
    """Return the Reason of each agent of `frame`, (n,) uint8.

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
    reason = np.full(len(crowd), Reason.DISTANCE, np.uint8)
    reason[painted != plain] = Reason.DETAIL_MAP
    reason[painted < finest] = Reason.LEFT_OUT
    reason[frame.levels != np.maximum(painted, finest)] = Reason.SHOT_PLAN
    reason[frame.levels == 0] = Reason.NEAR_ENOUGH
    culled = np.flatnonzero(~frame.visible)
    reason[culled] = Reason.BESIDE
    depth = frame.depths[culled]
    reach = spheres.reach[crowd.group[culled]] if policy.margin is None else 0.0
    camera = frame.camera
    if camera.kind == "PANO":
        before, behind = depth < camera.near - reach, depth > camera.far + reach
    else:
        before, behind = beyond_clips(frustum_of(camera), depth, reach)
    reason[culled[before]] = Reason.NEAR
    reason[culled[behind]] = Reason.FAR
    if frame.hidden is not None:
        reason[frame.hidden] = Reason.BEHIND_SCENERY
    if crowd.present is not None:
        reason[~crowd.present] = Reason.ABSENT
    if frame.plan_row is not None:
        reason[
            (frame.plan_row & HIDDEN != 0) | (frame.visible & (frame.plan_row & OVERRIDDEN != 0))
        ] = Reason.OVERRIDE
    return reason
