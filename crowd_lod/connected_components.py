"""Connected components: which vertices edges and faces join."""

import numpy as np


def connected_components(count: int, joined: np.ndarray) -> np.ndarray:
    """The component of each of `count` vertices, named by its least vertex.

    joined: (m, k) vertices, those of a row joined: edges (m, 2), triangles (m, 3). Returns (count,) intp.
    """
    label, before = np.arange(count), None
    while before is None or (label != before).any():
        before = label.copy()
        least = label[joined].min(axis=1)
        for column in joined.T:
            np.minimum.at(label, label[column], least)
            np.minimum.at(label, column, least)
        label = label[label]
    return label
