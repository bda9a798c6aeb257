"""Poses: at how many evenly spaced phases of its action a LOD is kept, and which of them an agent shows."""

import numpy as np

from .camera import Camera

# Fewer poses would save next to nothing. More than MOST, a second's walk in steps of a third of a frame, only serve one
# who asks for a tolerance, and then only LODs of so few vertices that they take no more memory than LOD 0 in MOST poses: a
# renderer holds a mesh for each pose that it shows.
LEAST, MOST, MOST_ASKED = 8, 64, 256
TOLERANCE = 1.0  # pixels, where the LODs have none of their own


def path_pixels(path: np.ndarray, begin: np.ndarray, radius: np.ndarray, camera: Camera) -> np.ndarray:
    """(G, n) pixels that a vertex's way in a cycle shows where each LOD begins, that is where its agents are largest.

    path: (G,) metres, the upper bound of a vertex's way in a cycle: so many times the longest step from one of so many
    even phases to the next (the last to the first does not count, an action need not be closed). begin: (G, n - 1)
    metres, from levels.limits; LOD 0 begins at the near plane. radius: (G,) metres, of the bounding spheres, by which a
    surface may be nearer than an agent's centre.
    """
    first = np.full((len(path), 1), -np.inf)
    distance = np.maximum(np.hstack([first, begin]) - radius[:, None], max(camera.near, 1e-9))
    if camera.kind == "ORTHO":  # shows a metre as so many pixels at any distance
        distance = np.ones_like(distance)
    return np.minimum(path, 1e9)[:, None] * camera.pixels_per_unit / distance  # an unknown way is infinite


def pose_counts(pixels: np.ndarray, vertices: np.ndarray, tolerance: float | None = None) -> np.ndarray:
    """(G, n) intp: poses in a cycle of each group's action, for each LOD, from path_pixels (G, n) and its vertices (G, n).

    An agent shows the nearest of `count` poses, in which a vertex is at most pixels / (2 count) from its place: the
    smallest power of two keeps that within the tolerance (pixels, TOLERANCE if None), but for the bounds. So the poses of a
    far LOD are among those of a near one. An action that moves nothing has one.
    """
    most = np.full(pixels.shape, MOST)
    if tolerance:
        spare = vertices[:, :1] / np.maximum(vertices, 1)
        most = np.clip(MOST * 2 ** np.rint(np.log2(np.maximum(spare, 1))), MOST, MOST_ASKED)
    needed = np.clip(pixels / (2 * (tolerance or TOLERANCE)), LEAST, most)
    counts = 2 ** np.ceil(np.log2(needed)).astype(np.intp)
    return np.where(pixels > 0, counts, 1)


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
