"""sRGB and linear colours."""

import numpy as np


def linear(encoded: np.ndarray) -> np.ndarray:
    """Linear RGB or RGBA (..., 3 or 4) of sRGB."""
    found = encoded.copy()
    rgb = encoded[..., :3]
    found[..., :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return found


def encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB from linear RGBA (..., 4) float32, as Blender's own shaders and text take it."""
    found = linear.copy()
    rgb = linear[..., :3]
    found[..., :3] = np.where(rgb < 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return found
