"""Poses: at how many evenly spaced phases of its action a LOD is kept, and which of them an agent shows."""

import numpy as np

from .camera import Camera

# Where the whole action is cheap to keep, fewer poses would only show; more than a blink apart is not seen.
LEAST, MOST = 8, 64
TOLERANCE = 1.0  # pixels, where the LODs have none of their own


def pose_counts(
    path: np.ndarray, begin: np.ndarray, radius: np.ndarray, camera: Camera, tolerance: float | None = None
) -> np.ndarray:
    """(G, n) intp: poses in a cycle of each group's action, for each LOD.

    A vertex moves at most path / count from one of `count` poses to the next, which shows as that many pixels where the
    LOD begins (where its agents are largest): the smallest power of two keeps this within the tolerance, but for the
    bounds LEAST and MOST. So the poses of a far LOD are among those of a near one. An action that moves nothing has one.

    path: (G,) metres, the upper bound of a vertex's way in a cycle: so many times the longest step from one of so many
    even phases to the next (the last to the first does not count, an action need not be closed). begin: (G, n - 1) metres, from
    levels.limits. radius: (G,) metres, of the bounding spheres, by which a surface may be nearer than an agent's centre.
    tolerance: pixels, TOLERANCE if None.
    """
    first = np.full((len(path), 1), -np.inf)
    distance = np.maximum(np.hstack([first, begin]) - radius[:, None], camera.near)
    if camera.kind == "ORTHO":  # shows a metre as so many pixels at any distance
        distance = np.ones_like(distance)
    pixels = path[:, None] * camera.pixels_per_unit / np.maximum(distance, 1e-9)
    needed = np.clip(pixels / (tolerance or TOLERANCE), LEAST, MOST)
    counts = 2 ** np.ceil(np.log2(needed)).astype(np.intp)
    return np.where(path[:, None] > 0, counts, 1)


def longest_step(one: np.ndarray, other: np.ndarray) -> float:
    """The furthest that a vertex is in metres from where it is in the other pose, each (v, 3); infinity if the poses
    have not the same vertices."""
    return float(np.linalg.norm(one - other, axis=1).max(initial=0.0)) if one.shape == other.shape else np.inf


def pose_of(phase: np.ndarray, group: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(m,) int32: the pose nearest to each agent's phase, as an index into all groups' poses of one LOD in turn.

    phase: (m,) in [0, 1); group: (m,); counts: (G,), poses of each group.
    """
    counts = np.asarray(counts, np.int64)
    of = counts[group]
    return ((np.cumsum(counts) - counts)[group] + np.rint(phase * of).astype(np.int64) % of).astype(np.int32)
