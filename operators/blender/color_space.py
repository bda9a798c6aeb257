"""sRGB and linear colours."""

import numpy as np

from ...crowd_lod import srgb


def linear(encoded: np.ndarray) -> np.ndarray:
    """Linear RGB or RGBA (..., 3 or 4) of sRGB."""
    return np.concatenate([srgb.linear(encoded[..., :3]), encoded[..., 3:]], axis=-1)


def encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB from linear RGBA (..., 4) float32, as Blender's own shaders and text take it."""
    return np.concatenate([srgb.encoded(linear[..., :3]), linear[..., 3:]], axis=-1)
