"""The inset: the crowd from above, in a corner of the viewport.

Source: chapter figure 1.5. Agents are points; the camera's frustum and LOD ranges are lines.
Off-color pixels of the label map are points over the agents.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...crowd_lod.world.maps import Area
from .draw_data import CULLED, FRUSTUM, Colors, Drawing
from .gpu_batches import Batches
from .gpu_draw import paint
from .hud import LETTERS, MARGIN, WHITE, HudLine, fill, write

if TYPE_CHECKING:
    from gpu.types import GPUTexture

SIZE = 360, 270  # nominal pixels
SMALLEST = 0.3  # of SIZE, below which there is none
MOST = 0.45  # of the viewport's width and height
INSET_MARGIN = 10.0  # nominal pixels
POINTS = 0.6  # how large agents are, compared with those in the viewport
BACKGROUND = 0.02, 0.02, 0.02, 1.0  # linear
STRAY = 1.0, 0.0, 1.0, 1.0  # linear RGBA, of the map's off-color pixels
CAPTIONED = 0.6  # of SIZE, below which it has no title, legend and scale


@dataclass(frozen=True)
class Above:
    """The crowd from above.

    texture: the picture, sRGB.
    width: units of the scene that it is wide.
    captions: its title, and the legend of what the overlay's own does not name.
    """

    texture: "GPUTexture"
    width: float
    captions: tuple[HudLine, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Pixels."""
        return self.texture.width, self.texture.height


def captions(colors: Colors) -> tuple[HudLine, ...]:
    """Return title and legend of the picture of agents in these `colors`."""
    culled = () if colors.culled else (HudLine("Culled", CULLED[:3]),)
    return HudLine("From above"), HudLine("Camera's view", FRUSTUM[:3]), *culled


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
    above: Above,
    box: tuple[float, float, float, float],
    legend: tuple[float, float],
    ui_scale: float,
    meters: float,
) -> None:
    """Draw the picture with title, legend and scale in the box's bottom right corner.

    It lies beside or below the text. Draws nothing where it would be smaller than SMALLEST of its
    size.

    box: (left, bottom, right, top) in pixels of the region.
    legend: (right, bottom) of the text, which begins in the box's top left corner.
    meters: in a unit of the scene.
    """
    from gpu_extras.presets import draw_texture_2d

    left, bottom, right, top = box
    width, height = SIZE
    margin = INSET_MARGIN * ui_scale
    free = max((right - legend[0] - 2 * margin) / width, (legend[1] - bottom - 2 * margin) / height)
    scale = min(ui_scale, free, MOST * (right - left) / width, MOST * (top - bottom) / height)
    if scale < SMALLEST * ui_scale:
        return
    wide = scale * width
    tall = scale * height
    at = right - margin - wide, bottom + margin
    draw_texture_2d(above.texture, at, wide, tall, is_scene_linear_with_rec709_srgb_target=True)
    if scale >= CAPTIONED * ui_scale:
        frame = at[0], at[1], at[0] + wide, at[1] + tall
        write(above.captions, frame, ui_scale)
        length, said = scale_bar(above.width * meters / 4)
        draw_scale(said, length / meters / above.width * wide, frame, ui_scale)


def scale_bar(longest: float) -> tuple[float, str]:
    """Return (meters, text) of the longest round length up to `longest` meters."""
    unit = 10.0 ** np.floor(np.log10(longest))
    length = unit * max(step for step in (1, 2, 5) if step * unit <= longest * (1 + 1e-9))
    return length, f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"


def draw_scale(
    said: str, length: float, frame: tuple[float, float, float, float], ui_scale: float
) -> None:
    """Draw a bar `length` pixels long in the lower right corner of `frame`, with its text above.

    frame: (left, bottom, right, top) in pixels of the region.
    """
    import blf

    right = frame[2] - MARGIN * ui_scale
    base = frame[1] + MARGIN * ui_scale
    fill(right - length, base, right, base + 2 * ui_scale, WHITE)
    blf.size(0, LETTERS * ui_scale)
    blf.color(0, *WHITE)
    blf.position(0, right - blf.dimensions(0, said)[0], base + 6 * ui_scale, 0)
    blf.draw(0, said)
