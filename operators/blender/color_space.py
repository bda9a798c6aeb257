"""Conversion between sRGB and linear colors."""

import numpy as np

from ...crowd_lod import srgb


def to_linear(encoded: np.ndarray) -> np.ndarray:
    """Return linear RGB or RGBA (..., 3 or 4) from sRGB; alpha stays."""
    return np.concatenate([srgb.linear(encoded[..., :3]), encoded[..., 3:]], axis=-1)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB from linear RGBA (..., 4) float32.

    This is what Blender's own shaders and text take.
    """
    return np.concatenate([srgb.encoded(linear[..., :3]), linear[..., 3:]], axis=-1)
