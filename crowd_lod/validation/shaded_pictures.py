"""Shaded pictures of a body as a renderer shows it from afar, and how alike two of them are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .. import srgb
from ..mesh import Mesh
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
BLOCK = 8  # pixels of a block, along each axis
WITHIN = 0.1  # of white: the mean difference of a block's colors that counts as none
LARGEST = 256  # pixels of a character's diagonal at which its LODs' pictures are compared
HALVINGS = 6  # of these, for pictures as they look from farther off


@dataclass(frozen=True, eq=False)
class ShadedMesh(Mesh):
    """A body to draw, points in meters.

    normals: (m, 3, 3), of each triangle's corners, of length 1.
    uvs: (m, 3, 2), of each triangle's corners.
    colors: (m, 3, 3), linear, of each triangle's corners.
    image: (m,), the number of the image that replaces the color, or -1.
    """

    normals: np.ndarray
    uvs: np.ndarray
    colors: np.ndarray
    image: np.ndarray


def pictures(
    bodies: Sequence[ShadedMesh], images: np.ndarray, flat: Sequence[np.ndarray], axes: np.ndarray
) -> list[np.ndarray]:
    """Return pictures (rows, columns, 3) float64 of the bodies, sRGB from 0 to 1.

    The arguments are those of `lit`, which gives the linear values.
    """
    return [srgb.encoded(each[..., :3]).clip(0, 1) for each in lit(bodies, images, flat, axes)]


def lit(
    bodies: Sequence[ShadedMesh], images: np.ndarray, flat: Sequence[np.ndarray], axes: np.ndarray
) -> list[np.ndarray]:
    """Return linear pictures (rows, columns, 4) float64 of the bodies.

    The last channel is the part of a pixel that the body covers. All have the same window, which
    holds all bodies.
    images: (i, size, size, 4) uint8, sRGB, bottom row first.
    flat: for each body (n, 3), its points in the picture: x right and y up in pixels, and depth.
    axes: (3, 3), the directions right, up and toward the camera.
    """
    low = np.min([points[:, :2].min(axis=0) for points in flat], axis=0) - MARGIN
    columns, rows = np.ceil(
        np.max([points[:, :2].max(axis=0) for points in flat], axis=0) + MARGIN - low
    ).astype(int)
    linear_pictures = []
    for body, points in zip(bodies, flat, strict=True):
        corners = ((points[:, :2] - low) * SUPERSAMPLING)[body.triangles]
        pixel, triangle, weights = rasterizer.nearest(
            corners, points[:, 2][body.triangles], (rows * SUPERSAMPLING, columns * SUPERSAMPLING)
        )
        normal = np.einsum("nk,nkd->nd", weights, body.normals[triangle])
        light = np.clip(
            normal @ (LIGHT @ axes) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12), 0, 1
        )
        fine = np.full((rows * SUPERSAMPLING * columns * SUPERSAMPLING, 4), PAPER)
        fine[:, 3] = 0.0
        fine[pixel, :3] = (
            _colors(body, images, triangle, weights) * (SKY + (1 - SKY) * light)[:, None]
        )
        fine[pixel, 3] = 1.0
        linear_pictures.append(
            fine.reshape(rows, SUPERSAMPLING, columns, SUPERSAMPLING, 4).mean(axis=(1, 3))
        )
    return linear_pictures


def from_afar(picture: np.ndarray, other_picture: np.ndarray) -> list[float]:
    """Return how much two pictures differ, at full size and after each of HALVINGS halvings.

    That is the largest mean of a block of BLOCK x BLOCK pixels, of 1, encoded as sRGB: of how far a
    color lies beyond those that the other picture has about its place. Outlines do not count.
    A pixel of a halved picture is the mean of four: it shows the body from twice as far.
    picture, other_picture: (rows, columns, 4), linear, from `lit`.
    """
    both = [picture, other_picture]
    differences = []
    for _ in range(HALVINGS + 1):
        both = [_of_blocks(values) for values in both]
        differences.append(_worst_block(*both))
        both = [values.reshape(len(values) // 2, 2, -1, 2, 4).mean(axis=(1, 3)) for values in both]
    return differences


def _of_blocks(picture: np.ndarray) -> np.ndarray:
    """Return the picture (rows, columns, 4), with empty pixels after it up to whole blocks."""
    rows, columns = (-(-length // BLOCK) * BLOCK for length in picture.shape[:2])
    whole = np.full((rows, columns, 4), PAPER)
    whole[..., 3] = 0.0
    whole[: len(picture), : picture.shape[1]] = picture
    return whole


def _worst_block(picture: np.ndarray, other_picture: np.ndarray) -> float:
    """Return the largest mean difference of blocks, which begin every half block."""
    covers = [values[..., 3] for values in (picture, other_picture)]
    colors = [
        srgb.encoded(
            (values[..., :3] - (1 - cover[..., None]) * PAPER) / np.maximum(cover, 1e-9)[..., None]
        ).clip(0, 1)
        for values, cover in zip((picture, other_picture), covers, strict=True)
    ]
    off = np.maximum(
        _beyond(colors[0], colors[1], covers[1]), _beyond(colors[1], colors[0], covers[0])
    )
    off *= np.minimum(*covers)
    half = BLOCK // 2
    rows, columns = (length // half for length in off.shape)
    quarters = off.reshape(rows, half, columns, half).sum(axis=(1, 3))
    return float(sliding_window_view(quarters, (2, 2)).sum(axis=(2, 3)).max() / BLOCK**2)


def _beyond(colors: np.ndarray, other_colors: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Return how far colors are from the range of the others about each pixel, (rows, columns).

    cover: (rows, columns), the part of each pixel that the others cover.
    """
    shown = (cover > 0)[..., None]
    low = -_highest_about(np.where(shown, -other_colors, -np.inf))
    high = _highest_about(np.where(shown, other_colors, -np.inf))
    beyond = np.maximum(low - colors, colors - high).clip(0).max(axis=2)
    return np.where(np.isfinite(beyond), beyond, 0.0)


def _highest_about(values: np.ndarray) -> np.ndarray:
    """Return the highest of the 3 x 3 values about each pixel (rows, columns, ...)."""
    wide = np.pad(values, [(1, 1), (1, 1), (0, 0)], mode="edge")
    across = np.maximum(np.maximum(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:])
    return np.maximum(np.maximum(across[:-2], across[1:-1]), across[2:])


def _colors(
    body: ShadedMesh, images: np.ndarray, triangle: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return linear colors (k, 3) at barycentric `weights` (k, 3) of triangles (k,)."""
    colors = np.einsum("nk,nkd->nd", weights, body.colors[triangle])
    image = body.image[triangle]
    textured = np.flatnonzero(image >= 0)
    if len(textured):
        size = images.shape[1]
        u, v = np.einsum("nk,nkd->dn", weights[textured], body.uvs[triangle[textured]])
        column, row = (np.floor(each % 1 * size).astype(int).clip(0, size - 1) for each in (u, v))
        colors[textured] = srgb.linear(images[image[textured], row, column, :3] / 255)
    return colors


def likeness(picture: np.ndarray, other_picture: np.ndarray) -> tuple[float, float]:
    """Return (mean absolute difference, mean structural similarity) of two pictures.

    The means are over pixels where either shows something: where it differs from its first pixel,
    which is empty. Without such pixels the result is (0, 1).
    picture, other_picture: (rows, columns, 3).
    Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
        structural similarity", 2004.
    """
    covered = (np.abs(picture - picture[0, 0]) > 1e-9).any(axis=2) | (
        np.abs(other_picture - other_picture[0, 0]) > 1e-9
    ).any(axis=2)
    if not covered.any():
        return 0.0, 1.0
    a, b = (each @ (0.2126, 0.7152, 0.0722) for each in (picture, other_picture))
    mean_a, mean_b, aa, bb, ab = (_blurred(each) for each in (a, b, a * a, b * b, a * b))
    same = (2 * mean_a * mean_b + STEADY[0]) * (2 * (ab - mean_a * mean_b) + STEADY[1])
    same /= (mean_a**2 + mean_b**2 + STEADY[0]) * (aa - mean_a**2 + bb - mean_b**2 + STEADY[1])
    return float(np.abs(picture - other_picture)[covered].mean()), float(same[covered].mean())


def _blurred(values: np.ndarray) -> np.ndarray:
    """Return the mean by WINDOW about each of `values`, with the border repeated."""
    for axis in (0, 1):
        wide = np.pad(values, [(5, 5) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        values = sum(w * np.roll(wide, -k, axis=axis) for k, w in enumerate(WINDOW))
        values = values[:-10] if axis == 0 else values[:, :-10]
    return values
