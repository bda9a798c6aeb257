"""The lines in which a mesh meets a level plane."""

import numpy as np


def section(points: np.ndarray, triangles: np.ndarray, z: float) -> np.ndarray:
    """Return the lines in which triangles meet the level plane at the height `z`.

    They are (k, 2, 2) float64, the segments' ends (x, y).

    points: (n, 3) float64; triangles: (m, 3) indices.
    A point in the plane counts as above it. So the lines of a closed surface are closed.
    """
    corners = points[triangles]
    above = corners[..., 2] >= z
    crossed = above != np.roll(above, -1, axis=1)  # of each side
    through = crossed.any(axis=1)  # then two sides are
    begin = corners[through][crossed[through]]
    end = np.roll(corners[through], -1, axis=1)[crossed[through]]
    # from below, so that neighbors find the same point
    down = (begin[:, 2] >= z)[:, None]
    low = np.where(down, end, begin)
    high = np.where(down, begin, end)
    part = (z - low[:, 2:]) / (high[:, 2:] - low[:, 2:])
    return (low + part * (high - low))[:, :2].reshape(-1, 2, 2)
