"""Which LODs of a character pay: chosen from a ladder of candidates by a tolerance in pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .agents import Group
from .camera import Camera
from .levels import LevelPolicy, limits
from .words import number

# Parts of the triangles that the candidates keep; MOST_LEVELS of them at most.
LADDER = (1.0, 0.4, 0.16, 0.06, 0.025, 0.01)
LEAST_SAVED = 0.2  # of the triangles of the next finer LOD, else a LOD is not worth a mesh
BETWEEN = 1.25  # between two frames that were looked at, agents may be nearer or farther by this factor


@dataclass(frozen=True)
class View:
    """Where a frame of the shot has agents of a group: from `nearest` to `farthest` metres of `camera`."""

    camera: Camera
    nearest: float
    farthest: float


def ruled_out(
    ratios: Sequence[float], known: dict[int, tuple[int, float]], radius: float, tolerance: float, views: Sequence[View], metres=1.0
) -> dict[int, str]:
    """Those of the candidates of `ratios` that need not be made, each with the reason, a sentence: coarser ones than one that begins
    behind all agents, which are taken to deviate more, and finer ones than one that begins before them all.

    known: of those made, the first among them, their triangles and bounds. radius: metres, of the bounding sphere. tolerance, views,
    metres: as in `choose`.
    """
    policy, found = LevelPolicy((0.0,), "PIXELS", tolerance=tolerance), {}
    nearest, farthest = np.array([(view.nearest, view.farthest) for view in views]).T
    for k in known.keys() - {0}:
        triangles, bound = known[k]
        begins = np.stack([limits(policy, view.camera, np.array([radius]), np.array([[0.0, bound]]))[0, 0] for view in views])
        if (begins > farthest * BETWEEN).all():
            edges, others, what = (begins, np.full_like(begins, np.inf)), range(k + 1, len(ratios)), f"{triangles:,}"
        elif (begins <= nearest / BETWEEN).all():
            edges, others, what = (np.where(np.isinf(begins), begins, 0.0), begins), range(1, k), "they"
        else:
            continue
        reason = _unused(0, np.stack(edges, axis=1), views, metres)
        found |= {
            j: f"About {ratios[j] * known[0][0]:,.0f} triangles were not tried: {what} {reason}" for j in others if j not in known
        }
    return found


def choose(group: Group, tolerance: float, views: Sequence[View], metres: float = 1.0) -> tuple[list[int], list[str]]:
    """(indices of the candidates to keep, why each of the others is dropped, a sentence each).

    group: with its candidates' triangles and bounds of deviation, finest first. The first is always kept: it is the character. Of
    the others one is dropped if one with fewer triangles deviates no more, if it saves less than LEAST_SAVED of the
    triangles of the finer one kept, or if in none of the views an agent is where it would be used, within the tolerance in
    pixels. metres: that a unit of length is, for the sentences.
    """
    kept, dropped = [0], []
    for k in range(1, len(group.triangles)):
        own, finer = group.triangles[k], group.triangles[kept[-1]]
        coarser = zip(group.triangles[k + 1 :], group.bounds[k + 1 :], strict=True)
        lower = [n for n, deviation in coarser if n < own and deviation <= group.bounds[k]]
        if lower:
            dropped.append(f"{own:,} triangles deviate no less than {lower[0]:,}.")
        elif own > (1 - LEAST_SAVED) * finer:
            dropped.append(f"{own:,} triangles save less than a fifth of the {finer:,} of the next finer LOD.")
        else:
            kept.append(k)
    deviation = np.array([[group.bounds[k] for k in kept]])
    policy = LevelPolicy((0.0,) * (len(kept) - 1), "PIXELS", tolerance=tolerance)
    used, begins = np.zeros(len(kept), bool), []
    for view in views:
        begin = limits(policy, view.camera, np.array([group.radius]), deviation)[0]
        edges = np.concatenate([[-np.inf], begin, [np.inf]])
        used |= (edges[:-1] < edges[1:]) & (edges[:-1] <= view.farthest * BETWEEN) & (edges[1:] > view.nearest / BETWEEN)
        begins.append(edges)
    for j in np.flatnonzero(~used[1:]) + 1:
        dropped.append(f"{group.triangles[kept[j]]:,} triangles {_unused(j, np.array(begins), views, metres)}")
    return [k for k, needed in zip(kept, used, strict=True) if needed or k == 0], dropped


def _unused(j: int, edges: np.ndarray, views: Sequence[View], metres: float) -> str:
    """Why no agent uses candidate j. edges: (views, candidates + 1) metres, where each candidate begins and the last ends.

    The figures are of the view that comes closest to using it."""
    begin, end = edges[:, j], edges[:, j + 1]
    nearest, farthest = np.array([(view.nearest, view.farthest) for view in views]).T
    coarse = begin > farthest
    if np.isinf(begin).all() and coarse.all():
        return "show more than the tolerance at any distance, for the camera is orthographic."
    if np.isinf(begin).all() and not coarse.any():
        return "are more than it takes at any distance, for the camera is orthographic."
    if coarse.all():
        i = (begin / farthest).argmin()
        return f"would begin {number(metres * begin[i])} m away, and the farthest agent is {number(metres * farthest[i])} m away."
    if not coarse.any():
        i = (end / nearest).argmax()
        return f"would end {number(metres * end[i])} m away, and the nearest agent is {number(metres * nearest[i])} m away."
    return (
        f"are too few for all agents in {coarse.sum()} of the {len(views)} frames looked at, and more than it takes in the others."
    )
