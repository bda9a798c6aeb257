"""The judge of colors: patches of two pictures that differ, edges of LODs aside.

Each pixel looks for its color within a tolerance in the other picture. What it does not find there
is averaged over blocks of pixels: an edge fills few pixels of a block, a lost shadow or another
material all of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..mesh import connected_components
from ..srgb import encoded

BLOCK = 8  # pixels of a block, along each axis
LARGEST = 0.1  # of 1, encoded as sRGB: the mean difference of a block from which on it is wrong


@dataclass(frozen=True)
class Patch:
    """Blocks side by side that differ.

    box: its rows and columns (low, high, left, right), pixels.
    off: the mean difference of its worst block, of 1, encoded as sRGB.
    brighter: by how much the other picture is brighter there, of 1; darker below 0.
    """

    box: tuple[int, int, int, int]
    off: float
    brighter: float


def compare(
    picture: np.ndarray, other_picture: np.ndarray, radius: float, ignored: np.ndarray
) -> tuple[np.ndarray, float, list[Patch]]:
    """Return (how far each pixel is off, the largest mean of a block, patches that are wrong).

    Of 1, encoded as sRGB; the first is (rows, columns) float32. The worst patch comes first.

    picture, other_picture: (rows, columns, 3 or more) float32, linear.
    radius: pixels within which a color is looked for.
    ignored: (rows, columns) bool, where colors may differ.
    """
    colors, other_colors = (
        encoded(each[..., :3].clip(0, 1)).astype(np.float32) for each in (picture, other_picture)
    )
    lost, added = _not_found(colors, other_colors, radius), _not_found(other_colors, colors, radius)
    off = np.maximum(lost, added)
    off[ignored] = 0
    blocks = block_means(off)
    brighter = block_means((other_colors - colors).mean(axis=2))
    patches = []
    for rows, columns in _side_by_side(blocks > LARGEST):
        low, left = BLOCK * rows.min(), BLOCK * columns.min()
        high = min(BLOCK * (rows.max() + 1), len(off))
        right = min(BLOCK * (columns.max() + 1), off.shape[1])
        box = int(low), int(high), int(left), int(right)
        worst = float(blocks[rows, columns].max())
        patches.append(Patch(box, worst, float(brighter[rows, columns].mean())))
    patches.sort(key=lambda patch: -patch.off)
    return off, float(blocks.max()), patches


def _not_found(picture: np.ndarray, other_picture: np.ndarray, radius: float) -> np.ndarray:
    """Return how far each pixel's color is from the nearest one about its place in the other.

    (rows, columns) float32; the difference of colors is that of their channel that differs most.
    """
    reach = int(radius)
    best = np.full(picture.shape[:2], np.inf, np.float32)
    rows, columns = best.shape
    framed = np.pad(other_picture, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            if down * down + right * right > radius * radius:
                continue
            moved = framed[reach + down :, reach + right :][:rows, :columns]
            np.minimum(best, np.abs(picture - moved).max(axis=2), out=best)
    return best


def block_means(values: np.ndarray) -> np.ndarray:
    """Return the mean of each block of (rows, columns, ...); blocks at the end may be smaller."""
    firsts = [np.arange(0, length, BLOCK) for length in values.shape[:2]]
    sums = np.add.reduceat(np.add.reduceat(values, firsts[0], axis=0), firsts[1], axis=1)
    sizes = [
        np.diff(np.append(first, length))
        for first, length in zip(firsts, values.shape[:2], strict=True)
    ]
    area = np.outer(*sizes)
    means: np.ndarray = sums / area.reshape(*area.shape, *[1] * (values.ndim - 2))
    return means


def _side_by_side(wrong: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the (rows, columns) of blocks that are wrong and touch one another, corners too."""
    number = np.arange(wrong.size).reshape(wrong.shape)
    neighbors = [
        (number[:, :-1], number[:, 1:]),
        (number[:-1], number[1:]),
        (number[:-1, :-1], number[1:, 1:]),
        (number[:-1, 1:], number[1:, :-1]),
    ]
    pairs = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in neighbors])
    joined = pairs[wrong.ravel()[pairs].all(axis=1)]
    part = connected_components(wrong.size, joined).reshape(wrong.shape)
    for first in np.unique(part[wrong]):
        yield np.nonzero((part == first) & wrong)
