"""Connected components of vertices that edges or faces join."""

import numpy as np


def connected_components(count: int, joined: np.ndarray) -> np.ndarray:
    """Return (count,) intp: the least vertex of each vertex's component.

    joined: (m, k) vertices, for example edges (m, 2) or triangles (m, 3). Each row joins its
        vertices.
    """
    label = np.arange(count)
    before = None
    while before is None or (label != before).any():
        before = label.copy()
        least = label[joined].min(axis=1)
        for column in joined.T:
            np.minimum.at(label, label[column], least)
            np.minimum.at(label, column, least)
        label = label[label]
    return label
