"""Cameras that look along an axis."""

from dataclasses import replace

import numpy as np
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window

ONE = np.array([0.0])


def turned(random):
    """A random rotation (3, 3)."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def narrow(shift=(0.0, 0.0, 0.0)):
    """A camera at (0, 0, 1) + shift that looks along +y as far as 40 m."""
    camera = straight(40.0, offset=np.add((0, 0, 1), shift))
    return replace(camera, window=Window(-0.4, 0.4, -0.3, 0.3), near=0.5, pixels=(640, 480))


def straight(far=100.0, kind="PERSP", offset=(0.0, 0.0, 0.0)):
    """A camera at `offset` that looks along +y, 90 degrees wide and high."""
    X, Y, Z = np.eye(3)[[0, 2, 1]]
    half = 1.0 if kind == "PERSP" else 5.0
    return Camera(
        kind,
        np.array(offset, float),
        X,
        Y,
        Z,
        Window(-half, half, -half, half),
        1.0,
        far,
        (100, 100),
    )
