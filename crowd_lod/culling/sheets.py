"""The sheets of opaque scenery in a picture, and where they end.

Triangles that face one way and go on from each other at their edges are a sheet. What it covers in
the picture ends at its border alone: at edges where no triangle of the sheet goes on.

Depths are kept as nearness, which is linear in the picture: 1 / meters along the view, or of an
orthographic camera minus meters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..mesh import connected_components
from .camera import GRAIN, Camera, Window, stretch
from .occluders import Occluders

ACROSS = 224  # cells along the longer side of the picture
# Cells are as many times as wide as high: below the horizon a cell shows much ground, of which the
# farthest counts, and the feet of what stands on it.
FLATTENED = 3
LEAST_CELLS = 3.0  # cells along both axes below which a component is not drawn
FLAT = 1e-12  # part of its size cubed, below which a triangle is edge-on
SLICE = 2.0  # times as far reaches each slice of depth
MOST_SLACK = 0.25  # cells, above which a triangle or a border is cut into slices
ROUNDING = 1e-9  # of cells and of nearness, several thousand roundings of float64


@dataclass(frozen=True)
class Grid:
    """The cells of a map.

    window: what they cover.
    columns, rows: their numbers.
    """

    window: Window
    columns: int
    rows: int

    def of_camera(self, camera: Camera) -> "Grid":
        """Return the same cells of another camera's picture."""
        return replace(self, window=camera.visible_window)

    @property
    def scale(self) -> np.ndarray:
        """(2,), cells per unit of the window."""
        w = self.window
        return np.array([self.columns / (w.right - w.left), self.rows / (w.top - w.bottom)])

    @property
    def low(self) -> np.ndarray:
        """(2,), the window's left and bottom."""
        return np.array([self.window.left, self.window.bottom])

    @property
    def size(self) -> np.ndarray:
        """(2,), columns and rows."""
        return np.array([self.columns, self.rows])


def grid_of(camera: Camera) -> Grid:
    """Return the grid of a PERSP or ORTHO camera's picture."""
    window = camera.visible_window
    wide = window.right - window.left
    high = window.top - window.bottom
    cell = max(wide, high) / ACROSS
    return Grid(window, max(1, round(wide / cell)), max(1, round(FLATTENED * high / cell)))


def nearest_cut(camera: Camera) -> float:
    """Return the meters along the view before which neither scenery nor agents count."""
    return camera.near * (stretch(camera)[1] if camera.rays else 1.0) * (1 + ROUNDING)


@dataclass(frozen=True)
class Sheets:
    """The sheets in a picture.

    triangles: (t, 3, 3), their corners in cells and nearness.
    sheet: (t,) intp, the sheet of each, numbered from 0.
    slack: (t, 2) cells by which its corners may lie elsewhere, across and up.
    borders: (b, 2, 2), ends of the borders in cells.
    border_sheet: (b,) intp.
    border_slack: (b, 2) cells.
    """

    triangles: np.ndarray
    sheet: np.ndarray
    slack: np.ndarray
    borders: np.ndarray
    border_sheet: np.ndarray
    border_slack: np.ndarray


def read_sheets(
    occluders: Occluders, components: np.ndarray, cameras: Sequence[Camera], grid: Grid
) -> Sheets:
    """Return the sheets of `components` (k,) in the picture of the first camera."""
    topology = occluders.topology
    number = np.flatnonzero(np.isin(topology.component, components))
    is_used = np.zeros(len(occluders.points), bool)
    is_used[topology.triangles[number]] = True
    row = np.cumsum(is_used) - 1  # of each vertex among those that are used
    points = occluders.points[is_used]
    views = [view_points(points, camera) for camera in cameras]
    facing = np.zeros(len(topology.triangles) + 1, np.intp)  # the last stands for no triangle
    facing[number] = _facing(views[0][row[topology.triangles[number]]], cameras[0])
    number = np.flatnonzero(facing)
    beside = facing[topology.sides]
    goes_on = (beside[:, 0] == beside[:, 1]) & (beside[:, 0] != 0)
    sheet = np.append(connected_components(len(topology.triangles), topology.sides[goes_on]), -1)
    grain = GRAIN * (np.abs(points).sum(axis=1) + np.abs(cameras[0].origin).sum())
    columns = np.concatenate([*views, grain[:, None]], axis=1)
    corners = columns[row[topology.triangles[number]]]
    of_corners = sheet[number]
    rows, side = np.nonzero((beside != 0) & ~goes_on[:, None])
    ends = columns[row[topology.edges[rows]]]
    of_ends = sheet[topology.sides[rows, side]]
    for k, camera in enumerate(cameras):
        cut = nearest_cut(camera)
        corners, of_corners, cuts, of_cuts = _cut_triangles(corners, of_corners, 3 * k + 2, cut)
        ends = np.concatenate([ends, cuts])
        ends, of_ends = _cut_segments(ends, np.concatenate([of_ends, of_cuts]), 3 * k + 2, cut)
    triangles, slack, of_corners = _picture_parts(corners, of_corners, cameras, grid)
    numbers, of_corners = np.unique(of_corners, return_inverse=True)
    stays = np.isin(of_ends, numbers)
    borders, border_slack, of_ends = _picture_parts(ends[stays], of_ends[stays], cameras, grid)
    of_ends = np.searchsorted(numbers, of_ends)
    return Sheets(triangles, of_corners, slack, borders[..., :2], of_ends, border_slack)


def view_points(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the points (n, 3) in camera coordinates: along X, Y and Z, meters."""
    return (points - camera.origin) @ np.array([camera.X, camera.Y, camera.Z]).T


def place_components(
    occluders: Occluders, camera: Camera, grid: Grid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where components may be in the picture: (low (c, 2), high (c, 2), nearness (c,)).

    low, high: in cells.
    nearness: of their nearest point beyond the near clip; -inf of those that cover no cell.
    """
    least, greatest = occluders.boxes
    middle = view_points((least + greatest) / 2, camera)
    half = (greatest - least) / 2 @ np.abs(np.array([camera.X, camera.Y, camera.Z])).T
    low = middle - half
    high = middle + half
    cut = nearest_cut(camera)
    near = np.maximum(low[:, 2:], cut)
    far = np.maximum(high[:, 2:], cut)
    nearness = -near[:, 0]
    if camera.kind != "ORTHO":
        low[:, :2] /= np.where(low[:, :2] < 0, near, far)
        high[:, :2] /= np.where(high[:, :2] > 0, near, far)
        nearness = 1 / near[:, 0]
    low = np.maximum((low[:, :2] - grid.low) * grid.scale, 0)
    high = np.minimum((high[:, :2] - grid.low) * grid.scale, grid.size)
    is_large = (high - low >= LEAST_CELLS).all(axis=1) & (far[:, 0] > cut)
    return low, high, np.where(is_large, nearness, -np.inf)


def _facing(corners: np.ndarray, camera: Camera) -> np.ndarray:
    """Return which way triangles (m, 3, 3) in camera coordinates face: 1, -1, or 0 if edge-on."""
    first, second, third = corners.transpose(1, 0, 2)
    if camera.kind == "ORTHO":
        volume = np.cross(second - first, third - first)[:, 2]
        size = np.abs(corners - corners[:, :1]).max(axis=(1, 2)) ** 2
    else:
        volume = np.einsum("ij,ij->i", first, np.cross(second, third))
        size = np.abs(corners).max(axis=(1, 2)) ** 3
    return np.where(np.abs(volume) > FLAT * size, np.sign(volume), 0).astype(np.intp)


def _cut_triangles(
    corners: np.ndarray, sheet: np.ndarray, depth: int, cut: float, beyond: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what of triangles lies beyond a depth: (corners, sheets, cuts, sheets of these).

    corners: (m, 3, c) columns of their corners.
    depth: the column that has it.
    beyond: False for what lies before it.
    cuts: (k, 2, c), the borders at which they are cut.
    """
    behind = (corners[:, :, depth] < cut) == beyond
    count = behind.sum(axis=1)
    parts = [corners[count == 0]]
    sheets = [sheet[count == 0]]
    borders = []
    border_sheets = []
    for alone in (1, 2):  # corners behind: one, whose triangle becomes two, or two
        rows = np.flatnonzero(count == alone)
        first = (behind[rows] == (alone == 1)).argmax(axis=1)
        apex, second, third = (corners[rows, (first + k) % 3] for k in range(3))
        left = _crossing(apex, second, depth, cut)
        right = _crossing(apex, third, depth, cut)
        triangles = (
            [(left, second, third), (left, third, right)] if alone == 1 else [(apex, left, right)]
        )
        parts.extend(np.stack(each, axis=1) for each in triangles)
        sheets.extend(sheet[rows] for _ in triangles)
        borders.append(np.stack([left, right], axis=1))
        border_sheets.append(sheet[rows])
    return (
        np.concatenate(parts),
        np.concatenate(sheets),
        np.concatenate(borders),
        np.concatenate(border_sheets),
    )


def _cut_segments(
    ends: np.ndarray, sheet: np.ndarray, depth: int, cut: float, beyond: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return what of segments (m, 2, c) lies beyond (or before) a depth, and their sheets."""
    behind = (ends[:, :, depth] < cut) == beyond
    stays = ~behind.all(axis=1)
    ends = ends[stays]
    behind = behind[stays]
    for k in (0, 1):
        rows = np.flatnonzero(behind[:, k])
        ends[rows, k] = _crossing(ends[rows, k], ends[rows, 1 - k], depth, cut)
    return ends, sheet[stays]


def _crossing(a: np.ndarray, b: np.ndarray, depth: int, cut: float) -> np.ndarray:
    """Return where segments from `a` (m, c) to `b` (m, c) cross the depth."""
    part = (cut - a[:, depth]) / (b[:, depth] - a[:, depth])
    crossing: np.ndarray = a + part[:, None] * (b - a)
    crossing[:, depth] = cut
    return crossing


def _picture_parts(
    parts: np.ndarray, sheet: np.ndarray, cameras: Sequence[Camera], grid: Grid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return triangles or segments in the picture: (vertices, slack as _picture has it, sheets).

    What reaches from the camera's feet to the horizon, such as ground, moves far near the camera
    and hardly in the distance: it is cut into slices, each with its own slack. What stays beside
    the picture is left out.

    parts: (m, k, c) columns of their vertices, beyond the near clip.
    """
    vertices, slack = _picture(parts, cameras, grid)
    wide = (slack.max(axis=1) > MOST_SLACK) & (cameras[0].kind != "ORTHO")
    if not wide.any():
        return vertices, slack, sheet
    slices, of_slices = _slices(parts[wide], sheet[wide], cameras[0])
    shown = ~_are_beside(slices, cameras)
    of_slices = of_slices[shown]
    sliced_vertices, sliced_slack = _picture(slices[shown], cameras, grid)
    return (
        np.concatenate([vertices[~wide], sliced_vertices]),
        np.concatenate([slack[~wide], sliced_slack]),
        np.concatenate([sheet[~wide], of_slices]),
    )


def _slices(parts: np.ndarray, sheet: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles or segments (m, k, c) cut into slices, and their sheets.

    They are cut along the sides of a window twice as wide and high, and then by depth: each slice
    reaches SLICE times as far as the one before.
    """
    low, high = _window_ends(camera, 0.5)
    for axis, slope in product((0, 1), (low, high)):
        beside = parts[..., axis] - slope[axis] * parts[..., 2]
        parts = np.concatenate([parts, beside[..., None]], axis=2)
        inside, outside, of_inside, of_outside = _halves(parts, sheet, -1, 0.0)
        parts = np.concatenate([inside, outside])[..., :-1]
        sheet = np.concatenate([of_inside, of_outside])
    slices = []
    sheets = []
    depth = nearest_cut(camera) * SLICE
    while len(parts) and depth < parts[:, :, 2].max():
        before, parts, of_before, sheet = _halves(parts, sheet, 2, depth)
        slices.append(before)
        sheets.append(of_before)
        depth *= SLICE
    return np.concatenate([*slices, parts]), np.concatenate([*sheets, sheet])


def _halves(
    parts: np.ndarray, sheet: np.ndarray, column: int, cut: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what of triangles or segments lies before and beyond `cut` in a column.

    Of each half the vertices, then of each the sheets.
    """
    halves = []
    sheets = []
    for beyond in (False, True):
        if parts.shape[1] == 2:
            half, of_half = _cut_segments(parts, sheet, column, cut, beyond)
        else:
            half, of_half, _, _ = _cut_triangles(parts, sheet, column, cut, beyond)
        halves.append(half)
        sheets.append(of_half)
    return halves[0], halves[1], sheets[0], sheets[1]


def _window_ends(camera: Camera, times: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (low, high), (2,) each, of the window with `times` its size more on each side."""
    w = camera.visible_window
    low = np.array([w.left, w.bottom])
    high = np.array([w.right, w.top])
    more = times * (high - low)
    return low - more, high + more


def _are_beside(parts: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """Return which of `parts` (m, k, c) lie on one side of the pictures of all cameras, (m,) bool.

    The pictures are taken half as large again, for what happens between the cameras.
    """
    sides = np.ones((len(parts), 2, 2), bool)
    for k, camera in enumerate(cameras):
        low, high = _window_ends(camera, 0.25)
        place = parts[..., 3 * k : 3 * k + 2]
        depth = parts[..., 3 * k + 2, None]
        sides[:, 0] &= (place < low * depth).all(axis=1)
        sides[:, 1] &= (place > high * depth).all(axis=1)
    beside: np.ndarray = sides.any(axis=(1, 2))
    return beside


def _picture(
    columns: np.ndarray, cameras: Sequence[Camera], grid: Grid
) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, y in cells and nearness (m, k, 3), slack (m, 2) in cells) of m times k vertices.

    Triangles (k = 3) are where the first camera has them, borders (k = 2) in the middle of where
    the cameras have them. Nearness is the least of all cameras. The slack, across and up, holds how
    far cameras move a vertex from there, and by how much renderers round its place.

    columns: (m, k, c), coordinates of each camera; last the rounding in meters.
    """
    pictures = np.array(
        [
            _in_cells(columns[..., 3 * k : 3 * k + 3], camera, grid.of_camera(camera))
            for k, camera in enumerate(cameras)
        ]
    )
    places = pictures[..., :2]
    low = places.min(axis=0)
    high = places.max(axis=0)
    place = places[0] if columns.shape[1] == 3 else (low + high) / 2
    moved = np.maximum(high - place, place - low)
    least = pictures[..., 2].min(axis=0)
    grain = columns[..., -1]
    scale = grid.scale.max()
    if cameras[0].kind == "ORTHO":
        rounding = grain * scale
        least = least - grain
    else:
        aside = np.abs(places + grid.low * grid.scale).max(axis=(0, -1))
        rounding = grain * pictures[..., 2].max(axis=0) * (scale + aside)
        least = least * (1 - np.minimum(grain * least, 1))
    slack = (moved + rounding[..., None]).max(axis=1, initial=0.0)
    slack += ROUNDING * (1 + np.abs(place).max(axis=(1, 2), initial=0.0))[:, None]
    return np.concatenate([place, least[..., None]], axis=-1), slack


def _in_cells(points: np.ndarray, camera: Camera, grid: Grid) -> np.ndarray:
    """Return x and y in cells and the nearness of points (..., 3) in camera coordinates."""
    pictured = points.copy()
    if camera.kind == "ORTHO":
        pictured[..., 2] = -points[..., 2]
    else:
        pictured[..., 2] = 1 / points[..., 2]
        pictured[..., :2] *= pictured[..., 2:]
    pictured[..., :2] = (pictured[..., :2] - grid.low) * grid.scale
    return pictured
