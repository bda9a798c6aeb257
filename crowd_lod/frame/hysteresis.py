"""Causal hysteresis for live views: a frame depends on the one shown before it."""

import numpy as np

from ..levels.assignment import hold
from ..sorting.buckets import sort
from .frame import Frame
from .planned import with_levels


def hold_levels(frame: Frame, previous: np.ndarray) -> Frame:
    """Return `frame` with LODs that change only beyond its policy's hysteresis.

    The same agents are visible.
    previous: (n,) uint8, the LODs of the frame before.
    """
    levels = hold(
        previous,
        frame.distances,
        frame.begins,
        frame.crowd.group,
        frame.factors,
        frame.policy.hysteresis,
    )
    return with_levels(frame, sort(frame.visible, levels, frame.policy.count), levels)
