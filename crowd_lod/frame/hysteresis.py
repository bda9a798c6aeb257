"""Causal hysteresis for live views: a frame depends on the one shown before it."""

import numpy as np

from ..levels.assignment import hold
from ..sorting.buckets import sort
from .frame import Frame
from .planned import relevelled


def held(frame: Frame, previous: np.ndarray) -> Frame:
    """`frame` with the LODs `previous` (n,) uint8 held by its policy's hysteresis. Who is visible
    stays.
    """
    crowd = frame.crowd
    policy = frame.policy
    levels = hold(
        previous, frame.distances, frame.begins, crowd.group, frame.factors, policy.hysteresis
    )
    return relevelled(frame, sort(frame.visible, levels, policy.count), levels)
