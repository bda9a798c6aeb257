"""The picture of a character's LODs, side by side.

One row shows the meshes with their edges, the other is tinted by the distance to the source.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ....crowd_lod.format import number
from ....crowd_lod.progress import run_in_thread
from ....crowd_lod.simplification import rasterizer
from ...lods.posed_surface import InPose
from ...lods.surface import Surface
from .lettering import write

SUPERSAMPLING = 2  # pixels drawn across a pixel of the picture
TALL = 380  # pixels of the character's height
GAP = 22  # pixels
LETTER = 15  # pixels high
PAPER = (0.94, 0.945, 0.955)
CLAY = (0.66, 0.71, 0.79)
EDGE = (0.10, 0.16, 0.30)
# surface that nobody sees; a LOD's worst place
HIDDEN = (0.62, 0.62, 0.62)
MARK = (0.85, 0.10, 0.10)
RING = 9.0  # pixels, of the ring about that
# Of distances that the colors tell apart, by their logarithm: else nothing were seen of a fine LOD
# beside a coarse one.
DECADES = 3
LIGHT = np.array([0.35, 0.45, 0.82])  # right, up, towards the eye
# viridis, which reads alike for color-blind eyes and in gray (van der Walt, Smith)
VIRIDIS = "440154 482878 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725"
RAMP = np.array([list(bytes.fromhex(color)) for color in VIRIDIS.split()]) / 255


def ramp(part: np.ndarray) -> np.ndarray:
    """Return colors (n, 3) for values (n,) from 0 to 1."""
    return np.stack(
        [np.interp(part, np.linspace(0, 1, len(RAMP)), channel) for channel in RAMP.T], axis=1
    )


def draw_lods(
    views: Sequence[InPose],
    captions: Sequence[str],
    notes: Sequence[str],
    azimuth: float,
    meters: float = 1.0,
) -> Generator[float, None, tuple[np.ndarray, float]]:
    """Draw all LODs of a character: yield between steps, return (picture, meters of the brightest
    color).

    The picture is (rows, columns, 4) uint8, bottom row first. The lower row shows how far each LOD
    deviates, its worst place ringed. Beneath LOD 0 it shows the surface that nobody sees.

    views: each LOD with its character, in the pose where it deviates most.
    captions, notes: a line above, and below, each LOD.
    azimuth: radians, direction from the character to the eye.
    meters: meters in a unit of length of the surfaces.
    """
    axes = _axes(azimuth)
    flat_points = [view.level.points @ axes.T for view in views]
    corners, scale, size = _fit(flat_points)
    fine = size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING
    drawings = []
    deviations = []
    for points, corner, view in zip(flat_points, corners, views, strict=True):
        places = (points - corner) * scale * SUPERSAMPLING
        drawing = yield from run_in_thread(partial(_look, places, view.level, fine))
        measuring = partial(_distances, view.character, view.level, *drawing[:3])
        deviations.append((yield from run_in_thread(measuring)))
        drawings.append(drawing)
    most = meters * max((float(d.max(initial=0)) for d in deviations), default=0.0)
    layout = _Layout(len(views), *size)
    sheet = layout.blank()
    for k, view in enumerate(views):
        tint = ramp(
            1 + np.log10(np.maximum(meters * deviations[k] / (most or 1.0), 1e-9)) / DECADES
        )
        yield from run_in_thread(partial(_draw_shaded, sheet, layout, k, drawings[k], tint))
        if deviations[k].any():
            up = (view.worst @ axes[1] - corners[k][1]) * scale
            across = (view.worst @ axes[0] - corners[k][0]) * scale
            _ring(sheet, GAP + up, layout.left(k) + across)
        elif view.hidden.any():
            inner = Surface(view.character.points, view.character.triangles[view.hidden])
            places = (inner.points @ axes.T - corners[k]) * scale * SUPERSAMPLING
            pixel, _, _, shade, _ = yield from run_in_thread(partial(_look, places, inner, fine))
            gray = np.array(HIDDEN) * shade[:, None]
            yield from run_in_thread(partial(_paste, sheet, GAP, layout.left(k), pixel, gray, size))
        _write_captions(sheet, layout, k, captions[k], notes[k])
        yield 0.0
    if most:
        _draw_color_bar(sheet, layout, most)
        yield 0.0
    pixels = np.full((*sheet.shape[:2], 4), 255, np.uint8)
    pixels[..., :3] = np.rint(sheet * 255)
    return pixels, most


def _axes(azimuth: float) -> np.ndarray:
    """Return the picture's axes, (3, 3): right, up, and towards the eye, which looks down a bit."""
    towards = np.array([np.cos(azimuth) * 0.985, np.sin(azimuth) * 0.985, 0.17])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def _fit(
    flat_points: Sequence[np.ndarray],
) -> tuple[list[np.ndarray], float, tuple[int, int]]:
    """Fit all LODs into cells of one size, each in the middle of its own: a pose may be elsewhere.

    flat_points: of each LOD (n, 3), along the picture's axes.

    Returns (each cell's lower left corner (3,), pixels per unit, (height, width) in pixels).
    """
    low = [points.min(axis=0) for points in flat_points]
    high = [points.max(axis=0) for points in flat_points]
    extent = np.max([b - a for a, b in zip(low, high, strict=True)], axis=0)
    corners = [(a + b - extent) / 2 for a, b in zip(low, high, strict=True)]
    scale = TALL / max(extent[1], extent[0] / 1.5)
    return corners, scale, (int(extent[1] * scale) + 2, int(extent[0] * scale) + 2)


@dataclass(frozen=True)
class _Layout:
    """Where things stand on the sheet, in pixels.

    count: how many LODs stand side by side.
    height, width: of one LOD.
    """

    count: int
    height: int
    width: int

    @property
    def cell(self) -> int:
        """The width of a LOD with its captions."""
        return max(self.width, 10 * LETTER) + GAP

    def blank(self) -> np.ndarray:
        """Return an empty sheet, (rows, columns, 3)."""
        rows = 2 * self.height + 4 * LETTER + 4 * GAP
        sheet = np.empty((rows, GAP + self.cell * self.count + 9 * LETTER, 3))
        sheet[:] = PAPER
        return sheet

    def left(self, k: int) -> int:
        """Return the column where LOD `k` begins."""
        return GAP + k * self.cell + (self.cell - GAP - self.width) // 2


def _draw_shaded(
    sheet: np.ndarray, layout: _Layout, k: int, drawing: tuple, tint: np.ndarray
) -> None:
    """Draw LOD `k` in clay, with the lines of its triangles, and beneath it in its tints.

    drawing: of _look.
    tint: (n, 3) color of each of its pixels.
    """
    pixel, _, _, shade, edge = drawing
    line = np.array(EDGE) * edge[:, None]
    clay = (np.array(CLAY) * shade[:, None]) * (1 - edge[:, None]) + line
    size = layout.height, layout.width
    _paste(sheet, layout.height + 2 * GAP, layout.left(k), pixel, clay, size)
    tinted = tint * (0.75 + 0.25 * shade[:, None])
    _paste(sheet, GAP, layout.left(k), pixel, tinted, size)


def _write_captions(sheet: np.ndarray, layout: _Layout, k: int, caption: str, note: str) -> None:
    """Write the title and the caption of LOD `k` above it, and its note below."""
    middle = GAP + k * layout.cell + (layout.cell - GAP) / 2
    above = 2 * layout.height + 3 * GAP
    title = middle, above + 2.1 * LETTER
    write(sheet, f"LOD {k}", title, 1.25 * LETTER, align="CENTER")
    write(sheet, caption, (middle, above + 0.5 * LETTER), LETTER, align="CENTER")
    write(sheet, note, (middle, GAP - 1.2 * LETTER), LETTER, align="CENTER")


def _draw_color_bar(sheet: np.ndarray, layout: _Layout, most: float) -> None:
    """Draw the bar that tells which color stands for which distance; most: meters at its top."""
    left = int(GAP + layout.cell * layout.count)
    bottom = int(GAP + layout.height * 0.1)
    height = int(layout.height * 0.8)
    colors = ramp(np.linspace(0, 1, height))
    sheet[bottom : bottom + height, left : left + LETTER] = colors[:, None]
    for decade in range(DECADES + 1):
        words = f"{number(1000 * most / 10**decade)} mm"
        words = f"< {words}" if decade == DECADES else words
        part = 1 - decade / DECADES
        row = bottom + part * height - 0.35 * LETTER
        write(sheet, words, (left + 1.5 * LETTER, row), LETTER)


def _ring(sheet: np.ndarray, row: float, column: float) -> None:
    """Draw a ring over the sheet about a place in pixels."""
    low = max(int(row - 2 * RING), 0)
    left = max(int(column - 2 * RING), 0)
    part = sheet[low : int(row + 2 * RING), left : int(column + 2 * RING)]
    rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
    off = np.hypot(rows + low - row, columns + left - column)
    for radius, color in ((RING + 1.5, PAPER), (RING, MARK)):
        part[np.abs(off - radius) < 1.2] = color


def _look(at: np.ndarray, surface: Surface, shape: tuple[int, int]) -> tuple:
    """Rasterize a surface: return (pixel, triangle, weights, shade, edge).

    at: (n, 3) the surface's points in pixels, the third towards the eye.
    pixel, triangle, weights: see rasterizer.nearest.
    shade: (k,) of a lit surface.
    edge: (k,) strength of the line along a triangle's edge there.
    """
    corners = at[surface.triangles]
    pixel, triangle, weights = rasterizer.nearest(corners[..., :2], -corners[..., 2], shape)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals *= np.where(normals[:, 2:] < 0, -1, 1)
    shade = 0.45 + 0.6 * (normals @ (LIGHT / np.linalg.norm(LIGHT))).clip(0, 1)
    flat = corners[..., :2]
    opposite = np.linalg.norm(np.roll(flat, -1, axis=1) - np.roll(flat, -2, axis=1), axis=2)
    u = flat[:, 1] - flat[:, 0]
    v = flat[:, 2] - flat[:, 0]
    doubled = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    heights = doubled[:, None] / np.maximum(opposite, 1e-12)
    line = (weights * heights[triangle]).min(axis=1) < 0.5 * SUPERSAMPLING
    # lines of a dense mesh must not hide its shape
    strength = np.clip(np.sqrt(doubled) / (9 * SUPERSAMPLING), 0.1, 0.85)
    return pixel, triangle, weights, shade[triangle].clip(0, 1), line * strength[triangle]


def _distances(character: Surface, surface: Surface, pixel, triangle, weights) -> np.ndarray:
    """Return the distance (k,) of what each pixel shows to `character`.

    It is in the surfaces' unit of length.
    """
    same = np.array_equal(character.points, surface.points) and np.array_equal(
        character.triangles, surface.triangles
    )
    if same or not len(pixel):
        return np.zeros(len(pixel))
    return character.distances(surface.at(triangle, weights))


def _paste(
    sheet: np.ndarray,
    row: int,
    left: int,
    pixel: np.ndarray,
    colors: np.ndarray,
    shape: tuple[int, int],
) -> None:
    """Paste drawn pixels over the sheet, reduced by SUPERSAMPLING.

    row, left: the lower left corner in the sheet.
    pixel: (k,) numbers of the drawn pixels, finer than the sheet by SUPERSAMPLING.
    colors: (k, 3).
    shape: (rows, columns) in the sheet.
    """
    fine = np.repeat(
        np.repeat(sheet[row : row + shape[0], left : left + shape[1]], SUPERSAMPLING, axis=0),
        SUPERSAMPLING,
        axis=1,
    )
    fine.reshape(-1, 3)[pixel] = colors
    blocks = fine.reshape(shape[0], SUPERSAMPLING, shape[1], SUPERSAMPLING, 3)
    sheet[row : row + shape[0], left : left + shape[1]] = blocks.mean(axis=(1, 3))
