"""The judge of outlines: who is seen at each sample of two pictures, compared agent by agent.

A sample at which the pictures show two agents is a matter of the nearer one: it stands where it
should not, or not where it should.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .silhouette import outside

NOBODY = -1
# Times what is allowed: the radius of the disc by which masks are opened. What is thinner counts
# for nothing, since it may be hidden by what is allowed on both of its sides.
OPENED = 1.25
THIN = 1.5  # samples: the least radius. What is thinner shows at some samples by chance
FEWEST = 4  # samples of an agent that is judged by its presence
OUTLINE, PRESENCE, UNJUDGED = "outline", "presence", ""


@dataclass(frozen=True)
class Judged:
    """What two pictures show of an agent.

    by: OUTLINE, PRESENCE or UNJUDGED.
    samples, other_samples: how many show it.
    error: samples by which its outline is off; infinite where it is missing in one of them. NaN if
        it is not judged.
    box: rows and columns (low, high, left, right) of what the pictures show of it.
    """

    by: str
    samples: int
    other_samples: int
    error: float
    box: tuple[int, int, int, int]


def judge(
    ids: np.ndarray, other_ids: np.ndarray, allowed: np.ndarray, depth: np.ndarray
) -> dict[int, Judged]:
    """Return what two pictures show of each agent that is in one of them.

    ids, other_ids: (rows, columns) int32, the agent at each sample, or NOBODY.
    allowed: (n,) samples by which the agent's outline may be off; NaN where that is not known.
    depth: (n,) meters, how far each agent is from the camera.
    """
    depths = np.append(depth, np.inf)  # of NOBODY, too
    framed = [np.pad(seen, 1, constant_values=NOBODY) for seen in (ids, other_ids)]
    judged = {}
    for agent, (low, high, left, right) in _boxes(ids, other_ids).items():
        pair = [seen[low : high + 2, left : right + 2] for seen in framed]
        covered = [depths[seen] < depths[agent] for seen in pair]
        by, error = _judge_one(pair, covered, agent, float(allowed[agent]))
        count, other_count = (int((seen == agent).sum()) for seen in pair)
        judged[agent] = Judged(by, count, other_count, error, (low, high, left, right))
    return judged


def _boxes(*pictures: np.ndarray) -> dict[int, tuple[int, int, int, int]]:
    """Return the rows and columns (low, high, left, right) of each agent in the pictures."""
    columns = pictures[0].shape[1]
    seen = [np.flatnonzero(ids != NOBODY) for ids in pictures]
    agents = np.concatenate([ids.ravel()[at] for ids, at in zip(pictures, seen, strict=True)])
    order = np.argsort(agents, kind="stable")
    row, column = np.divmod(np.concatenate(seen)[order], columns)
    found, first = np.unique(agents[order], return_index=True)
    if not len(found):
        return {}
    bounds = (
        np.minimum.reduceat(row, first),
        np.maximum.reduceat(row, first) + 1,
        np.minimum.reduceat(column, first),
        np.maximum.reduceat(column, first) + 1,
    )
    boxes = zip(*(bound.tolist() for bound in bounds), strict=True)
    return dict(zip(found.tolist(), boxes, strict=True))


def _judge_one(
    pair: list[np.ndarray], covered: list[np.ndarray], agent: int, allowed: float
) -> tuple[str, float]:
    """Return how an agent is judged, and by how many samples it is off.

    covered: (rows, columns) bool, where each picture shows one that is nearer.
    """
    if np.isnan(allowed):
        return UNJUDGED, np.nan
    masks = [seen == agent for seen in pair]
    radius = max(OPENED * allowed, THIN)
    middles = [_middles(mask, radius) for mask in masks]
    by_outline = middles[0].any() or middles[1].any()
    counts = [int(mask.sum()) for mask in masks]
    if not by_outline and max(counts) < FEWEST:
        return UNJUDGED, np.nan
    error = 0.0
    for k in (0, 1):
        # where the other picture shows it, or one before it in its place
        there = masks[1 - k] | (masks[k] & covered[1 - k])
        if not (masks[k] & ~there).any():
            continue
        if by_outline:
            opened = _around(middles[k], masks[k], radius)
            error = max(error, outside(opened, there)[2].max(initial=0.0))
        elif counts[k] >= FEWEST:
            nearest = 0.0 if (masks[k] & there).any() else outside(masks[k], there)[2].min()
            error = max(error, nearest if nearest <= allowed else np.inf)
    return (OUTLINE if by_outline else PRESENCE), float(error)


def _middles(mask: np.ndarray, radius: float) -> np.ndarray:
    """Return where a disc of this radius fits into the mask, whose border is empty."""
    middles = np.zeros_like(mask)
    if mask.sum() >= _samples_of_disc(radius):
        row, column, away = outside(mask, ~mask, radius)
        fits = away > radius
        middles[row[fits], column[fits]] = True
    return middles


def _around(middles: np.ndarray, mask: np.ndarray, radius: float) -> np.ndarray:
    """Return what of the mask lies within the discs about their middles."""
    covered = middles.copy()
    if middles.any():
        row, column, away = outside(mask, middles, radius)
        near = away <= radius
        covered[row[near], column[near]] = True
    return covered


@lru_cache(1024)
def _samples_of_disc(radius: float) -> int:
    along = np.arange(-int(radius), int(radius) + 1)
    return int((along[:, None] ** 2 + along**2 <= radius * radius).sum())
