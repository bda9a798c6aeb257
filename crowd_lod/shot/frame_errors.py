"""How many pixels the LODs of a frame may be off."""

import numpy as np

from ..frame.frame import Frame
from .recording import scale_of


def errors_of(frame: Frame) -> np.ndarray | None:
    """Return the pixels by which each visible agent's LOD deviates at most, (m,) float64.

    They are in the order of `frame.buckets`. None if LODs are not measured.
    """
    return _errors_at(frame, frame.buckets.order, frame.buckets.levels)


def worst_error(frame: Frame) -> float | None:
    """Return the largest of `errors_of`, 0 if nobody is visible; None if LODs are not measured.

    Of a single flat picture only the nearest agent of each group and LOD is judged: of 100,000
    agents, 1 ms instead of 25.
    """
    agents = frame.buckets.order
    levels = frame.buckets.levels
    if len(frame.eyes) == 1 and frame.camera.kind != "PANO":
        nearest = _nearest(frame)
        agents = agents[nearest]
        levels = levels[nearest]
    errors = _errors_at(frame, agents, levels)
    return None if errors is None else float(errors.max(initial=0.0))


def _errors_at(frame: Frame, agents: np.ndarray, levels: np.ndarray) -> np.ndarray | None:
    """Return the pixels of `errors_of` of `agents` (m,) with the LODs `levels` (m,)."""
    groups = frame.trajectory.groups
    count = len(frame.buckets.counts)
    if not all(len(group.bounds) >= count for group in groups):
        return None
    bounds = np.array([group.bounds[:count] for group in groups], np.float64)
    return scale_of(frame, agents) * bounds[frame.crowd.group[agents], levels]


def _nearest(frame: Frame) -> list[int]:
    """Return where in the buckets' order the nearest agent of each group and LOD stands."""
    crowd = frame.crowd
    agents = frame.buckets.order
    ahead = frame.camera.Z
    depth = crowd.x[agents] * ahead[0] + crowd.y[agents] * ahead[1] + crowd.z[agents] * ahead[2]
    nearest = []
    for first, last in zip(frame.buckets.offsets, frame.buckets.offsets[1:], strict=False):
        group = crowd.group[agents[first:last]]
        for g in range(len(frame.trajectory.groups)):
            (members,) = np.nonzero(group == g)
            if len(members):
                nearest.append(int(first + members[np.argmin(depth[first:last][members])]))
    return nearest
