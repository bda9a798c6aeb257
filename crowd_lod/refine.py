"""LOD points moved so that the worst distance between the surface and its source is least."""

import numpy as np

STEPS = 5
DAMPING = 0.7
SHARPEN = 2.0
WALKS = 2


def fit(points, triangles, source, landed):
    return points
