"""A small picture of a frame's agents: a mark for each, in the color of its LOD."""

import numpy as np

from ..culling.camera import Camera

BACKGROUND = (0.13, 0.13, 0.14)
SLENDER = 0.45  # the width of a mark, as a part of its height
RIM = 1.5  # pixels of a mark's edge that are darker
TINY = 1.0  # pixels of radius below which a mark is one pixel


def project_marks(
    camera: Camera, places: np.ndarray, radius: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Return (middles, radii, size) of marks in a picture that is `width` pixels wide.

    places: (n, 3) float64, meters from the camera's origin.
    radius: (n,) float64, meters.

    middles: (n, 2) float64 pixels from the bottom left; radii: (n,) float64 pixels.
    size: (width, height) of the picture. A panoramic camera's is equidistant: pixels are angles.
    """
    scale = width / camera.pixels[0]
    size = width, max(1, round(camera.pixels[1] * scale))
    flat = np.column_stack([places @ camera.X, places @ camera.Y])
    depth = places @ camera.Z
    distance = np.maximum(np.linalg.norm(places, axis=1), 1e-9)
    density = scale * camera.pixels_per_unit
    if camera.kind == "PANO":
        aside = np.maximum(np.linalg.norm(flat, axis=1), 1e-9)
        flat *= (np.arccos(np.clip(depth / distance, -1, 1)) / aside)[:, None]
        middles = density * flat + np.array(size) / 2
        return middles, density * radius / distance, size
    away = np.ones(len(depth)) if camera.kind == "ORTHO" else np.maximum(depth, camera.near)
    window = camera.window
    extent = window.right - window.left, window.top - window.bottom
    middles = (flat / away[:, None] - (window.left, window.bottom)) * (np.array(size) / extent)
    return middles, density * radius / away, size


def draw_marks(
    middles: np.ndarray, radii: np.ndarray, colors: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the picture of agents as upright ellipses, (height, width, 4) uint8, bottom row first.

    middles: (n, 2) float64 pixels from the bottom left, the farthest agent first.
    radii: (n,) float64 pixels, half the height of each mark.
    colors: (n, 3) float64 sRGB, 0 to 1.
    size: (width, height).
    """
    width, height = size
    picture = np.empty((height, width, 3))
    picture[:] = BACKGROUND
    is_tiny = radii < TINY
    column, row = np.floor(middles[is_tiny]).astype(int).T
    is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    picture[row[is_inside], column[is_inside]] = colors[is_tiny][is_inside]
    for (x, y), radius, color in zip(
        middles[~is_tiny], radii[~is_tiny], colors[~is_tiny], strict=True
    ):
        left, right = np.clip((x + radius * SLENDER * np.array((-1, 1))).round(), 0, width)
        bottom, top = np.clip((y + radius * np.array((-1, 1))).round(), 0, height)
        part = picture[int(bottom) : int(top), int(left) : int(right)]
        rows, columns = np.ogrid[int(bottom) : int(top), int(left) : int(right)]
        away = np.hypot((columns + 0.5 - x) / (radius * SLENDER), (rows + 0.5 - y) / radius)
        part[away <= 1] = np.multiply(color, 0.5)
        part[away <= 1 - RIM / radius] = color
    whole = np.full((height, width, 4), 255, np.uint8)
    whole[..., :3] = (255 * picture).round()
    return whole
