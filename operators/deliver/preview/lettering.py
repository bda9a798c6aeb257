"""Words over pictures in Blender's own font, and contact sheets with titles, labels and legends."""

from collections.abc import Generator, Sequence

import bpy
import numpy as np

from ....crowd_lod.output.tables import SHEET, contact_sheet
from ....crowd_lod.progress import run_in_thread
from ....crowd_lod.simplification import rasterizer
from ...blender import mesh_data, removal
from ...blender.colors import to_srgb

INK = (0.13, 0.14, 0.17)  # sRGB, on light paper
CHALK = (0.9, 0.9, 0.9)  # sRGB, on the dark of a contact sheet
LETTER = 15.0  # pixels high, on a contact sheet
LINE = 22  # pixels
GAP = 6  # pixels between the pictures of a contact sheet

# names, and their linear colors; a heading has none
Legend = Sequence[tuple[str, Sequence[float] | None]]


def _outlines(words: str, tall: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (n, 2) pixels and the triangles (m, 3) of `words`, from their left end on
    the base line.
    """
    curve = bpy.data.curves.new("Crowd LOD words", "FONT")
    curve.body = words
    curve.size = tall
    item = bpy.data.objects.new(curve.name, curve)
    mesh = bpy.data.meshes.new_from_object(item)
    try:
        read = mesh_data.read_mesh(mesh)
    finally:
        removal.remove([item, curve, mesh])
    return read.points[:, :2].astype(np.float64), read.triangles


def _length(words: str) -> float:
    """Return how long a line of a contact sheet is, pixels."""
    points, _ = _outlines(words, LETTER)
    return float(np.ptp(points[:, 0])) if len(points) else 0.0


def write(
    sheet: np.ndarray,
    words: str,
    place: tuple[float, float],
    tall: float = LETTER,
    align: str = "LEFT",
    widest: float = np.inf,
) -> float:
    """Write `words` over the sheet (rows, columns, 3), 0 to 1, sRGB; return their right end.

    They are light on a sheet with a dark corner, else dark.

    place: pixels from the lower left: the words' left end, or by `align` their middle, and the
        base line.
    tall: size of the letters, pixels; smaller where the words would be wider than `widest`.
    """
    points, triangles = _outlines(words, tall)
    if not len(triangles):
        return place[0]
    width = float(np.ptp(points[:, 0]))
    scale = min(1.0, widest / width)
    at = points * scale + place
    if align == "CENTER":
        at[:, 0] -= scale * width / 2
    color = INK if sheet[0, 0].mean() > 0.5 else CHALK
    finer = 4
    left, low = np.floor(at.min(axis=0)).astype(int).clip(0)
    part = sheet[low : int(at[:, 1].max()) + 2, left : int(at[:, 0].max()) + 2]
    rows, columns = part.shape[:2]
    ink = rasterizer.covered(
        ((at - (left, low)) * finer)[triangles], (rows * finer, columns * finer)
    )
    part += ink.reshape(rows, finer, columns, finer).mean(axis=(1, 3))[..., None] * (
        np.array(color) - part
    )
    return float(at[:, 0].max())


def labeled_sheet(
    pictures: list[np.ndarray],
    columns: int,
    titles: Sequence[str] = (),
    labels: Sequence[str] = (),
    legends: Sequence[Legend] = (),
) -> Generator[float, None, np.ndarray]:
    """Make a contact sheet of `pictures`: yield between steps, return it.

    It is (rows, columns, 4) uint8, bottom row first.

    titles: above each column; () without.
    labels: left of each row, of one or more lines; () without.
    legends: below, each in lines of its own.
    """
    sheet = yield from run_in_thread(lambda: contact_sheet(pictures, columns, GAP))
    if titles:
        strip = yield from _titles(titles, sheet.shape[1])
        sheet = np.concatenate([sheet, strip])
    if labels:
        strip = yield from _labels(labels, sheet.shape[0], bool(titles))
        sheet = np.concatenate([strip, sheet], axis=1)
    for legend in legends:
        strip = yield from _legend(legend, sheet.shape[1])
        sheet = np.concatenate([strip, sheet])
    return sheet


def _blank(rows: int, columns: int) -> np.ndarray:
    """Return an empty part of a sheet, (rows, columns, 3), sRGB."""
    return np.tile(np.array(SHEET[:3]) / 255, (rows, columns, 1))


def _pixels(sheet: np.ndarray) -> np.ndarray:
    """Return a sheet of values 0 to 1 as (rows, columns, 4) uint8."""
    pixels = np.full((*sheet.shape[:2], 4), 255, np.uint8)
    pixels[..., :3] = np.rint(sheet.clip(0, 1) * 255)
    return pixels


def _titles(titles: Sequence[str], width: int) -> Generator[float, None, np.ndarray]:
    """Write the titles side by side; yield between them."""
    strip = _blank(LINE, width)
    cell = (width - GAP) / len(titles)
    for number, title in enumerate(titles):
        middle = GAP + cell * number + (cell - GAP) / 2
        write(strip, title, (middle, 5.0), align="CENTER", widest=cell - 2 * GAP)
        yield 0.0
    return _pixels(strip)


def _labels(labels: Sequence[str], height: int, titled: bool) -> Generator[float, None, np.ndarray]:
    """Write the labels below each other; yield between them."""
    lines_of = [label.split("\n") for label in labels]
    widest = max(_length(line) for lines in lines_of for line in lines)
    strip = _blank(height, int(widest) + 2 * GAP)
    cell = (height - titled * LINE - GAP) / len(labels)
    for number, lines in enumerate(lines_of):
        middle = height - titled * LINE - GAP - cell * number - (cell - GAP) / 2
        first = middle + LINE * (len(lines) / 2 - 1) + 5
        for k, line in enumerate(lines):
            write(strip, line, (GAP, first - LINE * k))
            yield 0.0
    return _pixels(strip)


def _legend(legend: Legend, width: int) -> Generator[float, None, np.ndarray]:
    """Write the lines of a legend, as wide as the sheet: each color's square before its name.

    Yields between the names.
    """
    lines = [_blank(LINE, width)]
    right = float(GAP)
    for name, color in legend:
        if right > GAP and right + LINE + _length(name) + GAP > width:
            lines.append(_blank(LINE, width))
            right = float(GAP)
        if color is None:
            right -= LINE - 4.0
        else:
            left = int(right)
            linear = np.array([*color[:3], 1.0], np.float32)
            lines[-1][4:16, left : left + 12] = to_srgb(linear)[:3]
        end = write(lines[-1], name, (right + LINE - 4, 5.0), widest=width - right - LINE)
        right = end + 3 * GAP
        yield 0.0
    return _pixels(np.concatenate(lines[::-1]))
