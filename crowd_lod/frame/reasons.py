"""Why an agent is culled, or does not have the finest LOD; and the agent under the cursor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from ..culling.frustum import beyond_clips, frustum_of
from ..culling.radar import BLOCK
from ..errors import CrowdError
from ..levels.assignment import assign, deviations, pixels_of, threshold_distances
from ..sorting.buckets import sort
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
    Reason.BEHIND_SCENERY: "occluded",
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


SIDES = "right of", "left of", "above", "below"  # in the order of a frustum's planes


@dataclass(frozen=True)
class Account:
    """The details of one agent.

    reason: one of reasons.REASONS; of an agent beside the frame, on which side of it.
    depth: meters to its sphere's center, along the view (PANO: straight).
    error: pixels that its LOD deviates at most; None if not measured, or behind the camera.
    """

    agent: int
    visible: bool
    reason: str
    level: int
    depth: float
    error: float | None


def nearest(
    places: Sequence[np.ndarray],
    matrix: np.ndarray,
    size: tuple[int, int],
    cursor: tuple[float, float],
    most_pixels: float,
    among: np.ndarray | None = None,
) -> int | None:
    """Return the agent nearest to the cursor in the picture, or None if none is near.

    places: x, y, z, each (n,) float64 world meters.
    matrix: (4, 4) float64, world to clip space (OpenGL's). Agents that it clips at near or far are
        skipped.
    size: the picture's, pixels.
    cursor: pixels from the picture's bottom left corner.
    most_pixels: the largest distance to the cursor, pixels.
    among: (n,) bool, the agents to choose from; None for all.

    Of several at the same distance, the first.
    """
    center = np.array([2 * cursor[0] / size[0] - 1, 2 * cursor[1] / size[1] - 1])
    half = size[0] / 2, size[1] / 2
    least = most_pixels**2
    nearest_agent = None
    points = np.ones((4, BLOCK))
    for start in range(0, len(places[0]), BLOCK):
        end = min(start + BLOCK, len(places[0]))
        for row, column in zip(points, places, strict=False):
            row[: end - start] = column[start:end]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            x, y, z, w = matrix @ points[:, : end - start]
            away = ((x / w - center[0]) * half[0]) ** 2 + ((y / w - center[1]) * half[1]) ** 2
        inside = (away <= least) & (w > 0) & (np.abs(z) <= w)
        if among is not None:
            inside &= among[start:end]
        near = np.flatnonzero(inside)
        if len(near):
            at = near[np.argmin(away[near])]
            if nearest_agent is None or away[at] < least:
                least = away[at]
                nearest_agent = start + int(at)
    return nearest_agent


def account(frame: Frame, agent: int) -> Account:
    """Return the details of an agent of `frame`.

    CrowdError if there is no agent with this index.
    """
    if not 0 <= agent < len(frame.crowd):
        raise CrowdError(
            f"There is no agent {agent}: the crowd has {len(frame.crowd):,}, from 0 on."
        )
    this = slice(agent, agent + 1)
    crowd = frame.crowd.of(this)
    levels = frame.levels[this]
    buckets = sort(frame.visible[this], levels, len(frame.buckets.counts))
    row = None if frame.plan_row is None else frame.plan_row[this]
    hidden = None if frame.hidden is None else frame.hidden[this]
    alone = replace(
        frame, crowd=crowd, buckets=buckets, known_levels=levels, plan_row=row, hidden=hidden
    )
    group = frame.trajectory.groups[crowd.group[0]]
    level = int(levels[0])
    camera = frame.camera
    depth = float(alone.depths[0])
    error = None
    if (depth > 0 or camera.kind == "ORTHO") and len(group.bounds) > level:
        error = float(pixels_of(group.bounds[level], depth, camera, group.radius))
    reason = Reason(int(reasons(alone)[0]))
    is_beside = reason == Reason.BESIDE and camera.kind != "PANO"
    return Account(
        agent=agent,
        visible=bool(alone.visible[0]),
        reason=_side(alone) if is_beside else REASONS[reason],
        level=level,
        depth=depth,
        error=error,
    )


def _side(alone: Frame) -> str:
    """Return on which side of the first camera's frame the only agent of `alone` is."""
    frustum = frustum_of(alone.camera)
    center = np.array(alone.crowd.places(alone.trajectory.spheres.center))[:, 0]
    outside = frustum.normals @ (center - frustum.origin) - frustum.offsets
    return f"{SIDES[outside[: len(SIDES)].argmax()]} the frame"
