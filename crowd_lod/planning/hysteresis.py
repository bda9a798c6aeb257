"""Causal hysteresis, for views that live: a frame that remembers the one shown before it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..crowd.agents import Group
from ..culling.camera import Camera
from ..culling.radar import radar
from ..levels.assignment import Bias, LevelPolicy, hold
from ..sorting.buckets import sort
from .frame import Frame, cost, tally


def held(
    frame: Frame,
    previous: np.ndarray,
    groups: tuple[Group, ...],
    cameras: Sequence[Camera],
    policy: LevelPolicy,
    bias: Bias | None = None,
) -> Frame:
    """`frame`, whose plan had the other arguments, with the LODs `previous` (n,) uint8 held by policy.hysteresis.

    Who is visible stays. It measures the distances once more, so it costs the culling's time again.
    """
    crowd = frame.crowd
    centre, radius = (np.array([getattr(group, name) for group in groups]) for name in ("centre", "radius"))
    _, distance = radar(crowd, cameras, centre, radius, policy.margin, policy.metric == "RADIAL")
    factor = None if bias is None else bias.at(crowd.x, crowd.y)
    levels = hold(previous, distance, frame.begins, crowd.group, factor, policy.hysteresis)
    buckets = sort(frame.visible, levels, policy.count)
    counted = tally(crowd, buckets, len(groups))
    vertices, _ = cost(counted, [group.vertices for group in groups])
    triangles, _ = cost(counted, [group.triangles for group in groups])
    return replace(frame, find_levels=lambda: levels, buckets=buckets, vertices=vertices, triangles=triangles)
