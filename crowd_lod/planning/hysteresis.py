"""Causal hysteresis for live views: a frame depends on the one shown before it."""

from dataclasses import replace

import numpy as np

from ..levels.assignment import hold
from ..sorting.buckets import sort
from .frame import Frame, cost, tally


def held(frame: Frame, previous: np.ndarray) -> Frame:
    """`frame` with the LODs `previous` (n,) uint8 held by its policy's hysteresis. Who is visible stays."""
    crowd, policy, groups = frame.crowd, frame.policy, frame.trajectory.groups
    levels = hold(previous, frame.distances, frame.begins, crowd.group, frame.factors, policy.hysteresis)
    buckets = sort(frame.visible, levels, policy.count)
    counted = tally(crowd, buckets, len(groups))
    vertices, _ = cost(counted, [group.vertices for group in groups])
    triangles, _ = cost(counted, [group.triangles for group in groups])
    return replace(frame, known_levels=levels, buckets=buckets, vertices=vertices, triangles=triangles)
