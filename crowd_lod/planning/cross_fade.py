"""Cross-fades between LODs, on the same thresholds that assign them."""

from collections.abc import Sequence

import numpy as np

from ..crowd.agents import Group
from ..culling.camera import Camera
from ..culling.radar import radar
from ..levels.assignment import Bias, LevelPolicy
from .frame import Frame


def fades_of(
    frame: Frame,
    groups: tuple[Group, ...],
    cameras: Sequence[Camera],
    policy: LevelPolicy,
    bias: Bias | None = None,
    width: float = 0.1,
) -> tuple[np.ndarray, np.ndarray]:
    """`fade` of each agent of `frame`, whose plan had the other arguments. Hysteresis, which remembers, has no part in
    it: a LOD that fades in does not pop."""
    crowd = frame.crowd
    centre, radius = (np.array([getattr(group, name) for group in groups]) for name in ("centre", "radius"))
    _, distance = radar(crowd, cameras, centre, radius, policy.margin, policy.metric == "RADIAL")
    factor = None if bias is None else bias.at(crowd.x, crowd.y)
    return fade(distance, frame.begins, crowd.group, factor, width)


def fade(
    distance: np.ndarray,
    begins: np.ndarray,
    group: np.ndarray,
    factor: np.ndarray | None = None,
    width: float = 0.1,
) -> tuple[np.ndarray, np.ndarray]:
    """(finer, share): of agents near a limit the finer of its two LODs, and how much of the coarser one shows.

    distance, group, factor: as in levels.assign. begins: (G, n - 1), where LODs begin, from levels.limits. width: the part of a
    limit's distance by which the fade begins before it and ends behind it; where limits are nearer to one another, half their
    gap. finer: (n,) uint8. share: (n,) float32 in [0, 1], a half at the limit; 0 where only the LOD `finer` shows. What the
    finer LOD leaves out of a dither pattern the coarser one fills in.
    """
    if factor is not None:
        distance = distance * factor
    finer, share = np.zeros(len(distance), np.uint8), np.zeros(len(distance), np.float32)
    for i, (begin, end) in enumerate(zip(*_bands(begins, width), strict=True)):
        low, high = begin[group], end[group]
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(high > low, (distance - low) / (high - low), distance >= low).astype(np.float32)
        finer[part >= 1] = i + 1
        within = (part > 0) & (part < 1)
        finer[within], share[within] = i, part[within]
    return finer, share


def _bands(limits: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Where each limit's fade begins and ends, (n - 1, G) metres each, of limits (G, n - 1). No two overlap."""
    with np.errstate(invalid="ignore"):
        gaps = np.diff(limits, axis=1) / 2
        half = np.where(np.isfinite(limits), np.abs(limits) * width, 0.0)
        half[:, 1:] = np.fmin(half[:, 1:], gaps)
        half[:, :-1] = np.fmin(half[:, :-1], gaps)
    return (limits - half).T, (limits + half).T
