"""Small crowds for the tests."""

import numpy as np
from crowd_lod_extension.crowd_lod.crowd.agents import Crowd, Group


def crowd_at(points, group=None):
    """Agents standing at the points (n, 3)."""
    points = np.asarray(points, float).reshape(-1, 3)
    n = len(points)
    zeros = np.zeros(n, np.float32)
    group = np.zeros(n, np.uint8) if group is None else np.asarray(group, np.uint8)
    return Crowd(*points.T.copy(), zeros, np.zeros(n, np.uint8), group, np.zeros(n, np.uint8))


def walker(stride=1.25, period=1.0, sizes=(1000, 400, 120)):
    return Group("walker", 0.9, 1.0, stride, period, sizes, tuple(2 * n for n in sizes))
