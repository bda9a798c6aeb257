"""Judges what culling changes of a picture that a sky lights."""

import numpy as np

from .. import srgb
from .color_patches import BLOCK, block_means

STEP = 1 / 255  # of a value as sRGB encodes it, from 0 to 1
MOST_SHARE = 0.001  # of the picture that may change by more than STEP


def changed_share(full: np.ndarray, culled: np.ndarray) -> float:
    """Return the part of the picture that changes by more than STEP, from 0 to 1.

    full, culled: (h, w, 3) linear light, rendered with the same seed and samples.

    It is that of squares of BLOCK pixels by their mean light, since one ray that meets another
    agent changes its own pixel by far more than all rays there would in the mean. A square should
    have a thousand rays, 16 a pixel: with fewer, noise is taken for change.
    """
    before, after = (srgb.encoded(_squares(picture).clip(0, 1)) for picture in (full, culled))
    return float((np.abs(after - before) > STEP).any(axis=-1).mean())


def _squares(picture: np.ndarray) -> np.ndarray:
    """Return the mean light of the picture's whole squares, (h / BLOCK, w / BLOCK, 3)."""
    rows, columns = (length // BLOCK * BLOCK for length in picture.shape[:2])
    return block_means(picture[:rows, :columns].astype(np.float64))
