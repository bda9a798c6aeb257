"""Small bodies of triangles."""

import numpy as np


def drum(around, along):
    """A closed cylinder of radius 1 from z = -1 to 1."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rings = [
        np.column_stack([np.cos(angle), np.sin(angle), np.full(around, z)])
        for z in np.linspace(-1, 1, along)
    ]
    points = np.concatenate([*rings, [[0, 0, -1], [0, 0, 1]]])
    i, j = (
        grid.ravel() for grid in np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij")
    )
    k = (j + 1) % around
    first = np.arange(around)
    a = i * around + j
    b = i * around + k
    c = (i + 1) * around + k
    d = (i + 1) * around + j
    last = first + (along - 1) * around
    caps = [
        np.column_stack([np.roll(first, -1), first, np.full(around, len(points) - 2)]),
        np.column_stack([last, np.roll(last, -1), np.full(around, len(points) - 1)]),
    ]
    return points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d]), *caps])


def ball(around, along, radius=1.0):
    """A closed ball about the origin: `along` rings of `around` vertices, and two poles."""
    points, triangles = drum(around, along)
    up = points[:, 2:] * np.pi / 2 * (along - 1) / (along + 1)
    points = np.concatenate([np.cos(up) * points[:, :2], np.sin(up)], axis=1)
    points[-2:, 2] = -1, 1
    return radius * points, triangles
