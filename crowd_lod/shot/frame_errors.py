"""By how many pixels the LODs of one frame deviate."""

import numpy as np

from ..frame.frame import Frame
from .survey import scale_of


def errors_of(frame: Frame) -> np.ndarray | None:
    """Return the pixels by which each visible agent's LOD deviates at most, (m,) float64.

    They are in the order of `frame.buckets`. None if LODs are not measured.
    """
    groups = frame.trajectory.groups
    count = len(frame.buckets.counts)
    if not all(len(group.bounds) >= count for group in groups):
        return None
    bounds = np.array([group.bounds[:count] for group in groups], np.float64)
    agents = frame.buckets.order
    group = frame.crowd.group[agents]
    return scale_of(frame, agents).astype(np.float64) * bounds[group, frame.buckets.levels]
