"""Cross-fades between LODs, at the thresholds that assign them."""

import numpy as np

from .frame import Frame


def fades_of(frame: Frame, width: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return `fade` of each agent of `frame`.

    Hysteresis has no part in it: a LOD that fades in does not pop.
    """
    return fade(frame.distances, frame.begins, frame.crowd.group, frame.factors, width)


def fade(
    distance: np.ndarray,
    begins: np.ndarray,
    group: np.ndarray,
    factor: np.ndarray | None = None,
    width: float = 0.1,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (finer, share): each agent's finer LOD, and the share of the coarser.

    Near a limit an agent shows two LODs.

    distance, group, factor: as in levels.assign.
    begins: (G, n - 1), where LODs begin, from levels.limits.
    width: the part of a limit's distance by which the fade begins before it and ends behind it;
        half the gap where two limits are nearer to each other.

    finer: (n,) uint8.
    share: (n,) float32 in [0, 1]; 0.5 at the limit, 0 where only the LOD `finer` shows. The coarser
        LOD fills the pixels of a dither pattern that the finer one leaves out.
    """
    if factor is not None:
        distance = distance * factor
    finer = np.zeros(len(distance), np.uint8)
    share = np.zeros(len(distance), np.float32)
    for i, (begin, end) in enumerate(zip(*_bands(begins, width), strict=True)):
        low = begin[group]
        high = end[group]
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(high > low, (distance - low) / (high - low), distance >= low).astype(
                np.float32
            )
        finer[part >= 1] = i + 1
        is_fading = (part > 0) & (part < 1)
        finer[is_fading] = i
        share[is_fading] = part[is_fading]
    return finer, share


def _bands(limits: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where each limit's fade begins and ends, (n - 1, G) meters each.

    No two fades overlap. limits: (G, n - 1) meters.
    """
    with np.errstate(invalid="ignore"):
        gaps = np.diff(limits, axis=1) / 2
        half = np.where(np.isfinite(limits), np.abs(limits) * width, 0.0)
        half[:, 1:] = np.fmin(half[:, 1:], gaps)
        half[:, :-1] = np.fmin(half[:, :-1], gaps)
    return (limits - half).T, (limits + half).T
