"""Rotations of agents, each axis by itself."""

import numpy as np


def stance(heading, pitch, roll, turn):
    """Return rotations (n, 3, 3) float64 from the character's space to the world.

    Rz(heading) Ry(-pitch) Rx(roll) Rz(turn), as the build's node group turns its instances.
    heading, pitch, roll: (n,) radians.
    turn: radians, the same for all.
    """
    return _about(2, heading) @ _about(1, -pitch) @ _about(0, roll) @ _about(2, np.array([turn]))


def _about(axis, angle):
    """Return rotations (n, 3, 3) float64 about a coordinate axis."""
    cos = np.cos(angle, dtype=np.float64)
    sin = np.sin(angle, dtype=np.float64)
    turned = np.zeros((len(angle), 3, 3))
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    turned[:, axis, axis] = 1
    turned[:, i, i] = turned[:, j, j] = cos
    turned[:, i, j] = -sin
    turned[:, j, i] = sin
    return turned
