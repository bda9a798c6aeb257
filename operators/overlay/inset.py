"""The inset: the crowd from above, in a corner of the viewport.

Source: chapter figure 1.5. Agents are points; the camera's frustum and LOD ranges are lines.
Off-color pixels of the label map are points over the agents.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...crowd_lod.crowd.maps import Area
from .draw_data import Drawing
from .gpu_batches import Batches
from .gpu_draw import paint

if TYPE_CHECKING:
    from gpu.types import GPUTexture

SIZE = 360, 270  # nominal pixels
SMALLEST = 0.3  # of SIZE, below which there is none
MOST = 0.45  # of the viewport's width and height
INSET_MARGIN = 10.0  # nominal pixels
POINTS = 0.6  # how large agents are, compared with those in the viewport
BACKGROUND = 0.02, 0.02, 0.02, 1.0  # linear
STRAY = 1.0, 0.0, 1.0, 1.0  # linear RGBA, of the map's off-color pixels


def with_strays(drawing: Drawing, strays: np.ndarray) -> Drawing:
    """Return the drawing of points with a point above all for each stray (k, 3) of the maps."""
    if not len(strays):
        return drawing
    marks = (strays - drawing.origin).astype(np.float32)
    marks[:, 2] = (
        np.maximum(marks[:, 2], drawing.positions[:, 2].max(initial=-np.inf)) + drawing.diameter
    )
    return replace(
        drawing,
        positions=np.concatenate([drawing.positions, marks]),
        colors=np.concatenate([drawing.colors, np.tile(np.float32(STRAY), (len(marks), 1))]),
        sizes=np.concatenate([drawing.sizes, np.ones(len(marks), np.float32)]),
    )


def from_above(area: Area, eye: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (view, projection), (4, 4) float64 each, of a view straight down, +y up.

    The view covers the area and the eye, and no height of `places` is clipped.

    eye: (3,) world meters.
    places: (n, 3) meters, relative to the eye.
    """
    aspect = SIZE[0] / SIZE[1]
    low = np.minimum(eye[:2], (area.x_min, area.y_min))
    high = np.maximum(eye[:2], (area.x_max, area.y_max))
    width, height = 1.06 * np.maximum(high - low, 1e-3)
    if width < height * aspect:
        width = height * aspect
    else:
        height = max(height, width / aspect)
    bottom, top = (eye[2] + end(places[:, 2]) for end in (np.min, np.max))
    view = np.eye(4)
    projection = np.eye(4)
    view[:3, 3] = *-(low + high) / 2, -(bottom + top) / 2
    projection[[0, 1, 2], [0, 1, 2]] = 2 / width, 2 / height, -2 / (1.1 * (top - bottom) + 1.0)
    return view, projection


def pixels(ui_scale: float) -> tuple[int, int]:
    """Return width and height of the inset's texture in pixels."""
    return round(SIZE[0] * ui_scale), round(SIZE[1] * ui_scale)


def picture(
    batches: Batches, view: np.ndarray, projection: np.ndarray, ui_scale: float
) -> "GPUTexture":
    """Return the inset painted to a texture of `pixels(ui_scale)`.

    The texture is sRGB. So both our linear colors and the colors that Blender's shaders encode look
    as in the viewport.
    """
    from gpu.types import GPUFrameBuffer, GPUTexture

    size = pixels(ui_scale)
    color = GPUTexture(size, format="SRGB8_A8")
    depth = GPUTexture(size, format="DEPTH_COMPONENT32F")
    canvas = GPUFrameBuffer(color_slots=color, depth_slot=depth)
    with canvas.bind():
        canvas.clear(color=BACKGROUND, depth=1.0)
        paint(batches, view, projection, size, POINTS * ui_scale)
    return color


def show(
    texture, box: tuple[float, float, float, float], legend: tuple[float, float], ui_scale: float
) -> None:
    """Draw the texture in the box's bottom right corner, beside or below the text.

    Draws nothing where it would be smaller than SMALLEST of its size.

    box: (left, bottom, right, top) in pixels of the region.
    legend: (right, bottom) of the text, which begins in the box's top left corner.
    """
    from gpu_extras.presets import draw_texture_2d

    left, bottom, right, top = box
    width, height = SIZE
    margin = INSET_MARGIN * ui_scale
    free = max((right - legend[0] - 2 * margin) / width, (legend[1] - bottom - 2 * margin) / height)
    scale = min(ui_scale, free, MOST * (right - left) / width, MOST * (top - bottom) / height)
    if scale >= SMALLEST * ui_scale:
        at = right - margin - scale * width, bottom + margin
        draw_texture_2d(
            texture, at, scale * width, scale * height, is_scene_linear_with_rec709_srgb_target=True
        )
