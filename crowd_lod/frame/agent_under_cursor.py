"""The agent under the cursor, and the details of one agent."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..culling.frustum import frustum_of
from ..culling.radar import BLOCK
from ..errors import CrowdError
from ..levels.assignment import pixels_of
from ..sorting.buckets import sort
from .frame import Frame
from .reasons import REASONS, Reason, reasons

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
