"""Pictures of a body as a renderer shows it from afar, and how alike two are.

A body is lit, in its colors and images.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import srgb
from ..simplification import rasterizer

SUPERSAMPLING = 3  # pixels drawn across one of the picture
# right, up, towards the eye
LIGHT = np.array([0.35, 0.45, 0.82]) / np.linalg.norm((0.35, 0.45, 0.82))
SKY = 0.3  # of the light: that from everywhere
PAPER = 0.18  # linear gray behind the body
MARGIN = 6  # pixels about the body, half a window of `likeness`
WINDOW = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
WINDOW /= WINDOW.sum()
STEADY = 0.01**2, 0.03**2  # the constants of structural similarity
# of white: the mean difference of two pictures that counts as none, five steps of a byte's 255
WITHIN = 0.02
LARGEST = 256  # pixels of a character's diagonal at which its LODs' pictures are compared
HALVINGS = 6  # of these, for pictures as they look from farther off


@dataclass(frozen=True)
class Body:
    """A body to draw.

    points: (n, 3) meters.
    triangles: (m, 3).
    normals: (m, 3, 3), of each triangle's corners, of length 1.
    uvs: (m, 3, 2), of each triangle's corners.
    colors: (m, 3), linear color of each triangle.
    image: (m,), the number of the image that replaces the color, or -1.
    """

    points: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    colors: np.ndarray
    image: np.ndarray


def pictures(
    bodies: Sequence[Body], images: np.ndarray, flat: Sequence[np.ndarray], axes: np.ndarray
) -> list[np.ndarray]:
    """Return pictures (rows, columns, 3) float64 of the bodies, sRGB from 0 to 1.

    The arguments are those of `lit`, which gives the linear values.
    """
    return [srgb.encoded(each).clip(0, 1) for each in lit(bodies, images, flat, axes)]


def lit(
    bodies: Sequence[Body], images: np.ndarray, flat: Sequence[np.ndarray], axes: np.ndarray
) -> list[np.ndarray]:
    """Return linear pictures (rows, columns, 3) float64 of the bodies.

    All have the same window, which holds all bodies.
    images: (i, size, size, 4) uint8, sRGB, bottom row first.
    flat: for each body (n, 3), its points in the picture: x right and y up in pixels, and depth.
    axes: (3, 3), the directions right, up and toward the camera.
    """
    low = np.min([at[:, :2].min(axis=0) for at in flat], axis=0) - MARGIN
    columns, rows = np.ceil(
        np.max([at[:, :2].max(axis=0) for at in flat], axis=0) + MARGIN - low
    ).astype(int)
    found = []
    for body, at in zip(bodies, flat, strict=True):
        corners = ((at[:, :2] - low) * SUPERSAMPLING)[body.triangles]
        pixel, triangle, weights = rasterizer.nearest(
            corners, at[:, 2][body.triangles], (rows * SUPERSAMPLING, columns * SUPERSAMPLING)
        )
        normal = np.einsum("nk,nkd->nd", weights, body.normals[triangle])
        light = np.clip(
            normal @ (LIGHT @ axes) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12), 0, 1
        )
        fine = np.full((rows * SUPERSAMPLING * columns * SUPERSAMPLING, 3), PAPER)
        fine[pixel] = _colors(body, images, triangle, weights) * (SKY + (1 - SKY) * light)[:, None]
        found.append(fine.reshape(rows, SUPERSAMPLING, columns, SUPERSAMPLING, 3).mean(axis=(1, 3)))
    return found


def from_afar(one: np.ndarray, other: np.ndarray) -> list[float]:
    """Return the mean differences of two pictures, at full size and halved.

    one, other: from `lit`. They are halved HALVINGS times, each pixel the mean of four; each time
        they look as from twice as far.
    """
    pad = 2 ** (HALVINGS + 1)
    found = []
    # what stays empty about the smallest
    sides = [(pad, pad + -length % pad) for length in one.shape[:2]]
    one, other = (np.pad(each, [*sides, (0, 0)], constant_values=PAPER) for each in (one, other))
    for _ in range(HALVINGS + 1):
        found.append(likeness(*(srgb.encoded(each).clip(0, 1) for each in (one, other)))[0])
        one, other = (
            each.reshape(len(each) // 2, 2, -1, 2, 3).mean(axis=(1, 3)) for each in (one, other)
        )
    return found


def _colors(
    body: Body, images: np.ndarray, triangle: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return linear colors (k, 3) at barycentric `weights` (k, 3) of triangles (k,)."""
    colors = body.colors[triangle]
    image = body.image[triangle]
    some = np.flatnonzero(image >= 0)
    if len(some):
        size = images.shape[1]
        u, v = np.einsum("nk,nkd->dn", weights[some], body.uvs[triangle[some]])
        column, row = (np.floor(each % 1 * size).astype(int).clip(0, size - 1) for each in (u, v))
        colors[some] = srgb.linear(images[image[some], row, column, :3] / 255)
    return colors


def likeness(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Return (mean absolute difference, mean structural similarity) of two pictures.

    The means are over pixels where either shows something: where it differs from its first pixel,
    which is empty. Without such pixels the result is (0, 1).
    one, other: (rows, columns, 3).
    Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
        structural similarity", 2004.
    """
    shown = (np.abs(one - one[0, 0]) > 1e-9).any(axis=2) | (np.abs(other - other[0, 0]) > 1e-9).any(
        axis=2
    )
    if not shown.any():
        return 0.0, 1.0
    a, b = (each @ (0.2126, 0.7152, 0.0722) for each in (one, other))
    mean_a, mean_b, aa, bb, ab = (_blurred(each) for each in (a, b, a * a, b * b, a * b))
    same = (2 * mean_a * mean_b + STEADY[0]) * (2 * (ab - mean_a * mean_b) + STEADY[1])
    same /= (mean_a**2 + mean_b**2 + STEADY[0]) * (aa - mean_a**2 + bb - mean_b**2 + STEADY[1])
    return float(np.abs(one - other)[shown].mean()), float(same[shown].mean())


def _blurred(values: np.ndarray) -> np.ndarray:
    """Return the mean by WINDOW about each of `values`, with the border repeated."""
    for axis in (0, 1):
        wide = np.pad(values, [(5, 5) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        values = sum(w * np.roll(wide, -k, axis=axis) for k, w in enumerate(WINDOW))
        values = values[:-10] if axis == 0 else values[:, :-10]
    return values
