"""Differences of two pictures."""

from dataclasses import dataclass

import numpy as np

# Part of a value above 1, or of 1, by which renderers may round it: of two renders whose meshes
# have other instances, single pixels were off by 3.8e-6.
NOISE = 1e-5
VISIBLE = 2 / 255


@dataclass(frozen=True)
class Difference:
    """The difference of two pictures.

    pixels: how many differ by more than NOISE.
    visible: how many differ by more than VISIBLE in a linear channel.
    share: the visible ones' part of the picture.
    largest, mean, rms: of the absolute difference, over pixels and channels.
    """

    pixels: int
    visible: int
    share: float
    largest: float
    mean: float
    rms: float


def difference_of(a: np.ndarray, b: np.ndarray) -> Difference:
    """Return the difference of two linear pictures (rows, columns, channels) float32.

    Values are equal if they compare equal, or if both are NaN.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(a - b)
    off[(a == b) | (np.isnan(a) & np.isnan(b))] = 0
    off[np.isnan(off)] = np.inf
    most = off.max(axis=2)
    visible = int((most > VISIBLE).sum())
    finite = np.minimum(off, np.finfo(np.float32).max)
    mean = finite.mean(dtype=np.float64)
    rms = np.sqrt(np.square(finite, dtype=np.float64).mean())
    with np.errstate(invalid="ignore"):
        large = np.fmax(np.fmax(np.abs(a), np.abs(b)), 1.0)
        differs = (off > NOISE * large).any(axis=2) | np.isinf(most)
    return Difference(
        int(differs.sum()),
        visible,
        visible / most.size,
        float(finite.max()),
        float(mean),
        float(rms),
    )
