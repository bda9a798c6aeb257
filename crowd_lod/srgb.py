"""The transfer functions of sRGB. Source: IEC 61966-2-1."""

import numpy as np


def encoded(linear: np.ndarray) -> np.ndarray:
    """Return the sRGB values of linear values, of any shape; not clipped above 1."""
    return np.where(
        linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055
    )


def linear(encoded: np.ndarray) -> np.ndarray:
    """Return the linear values of sRGB values, of any shape."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
