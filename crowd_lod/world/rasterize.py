"""Meshes as a map needs them: seen from above as cells, and cut by a level plane."""

from collections.abc import Iterator

import numpy as np

from .maps import Area

OVERLAPS = 1_000_000  # triangles times cells that are compared at a time


def cover_cells(triangles: np.ndarray, area: Area, rows: int, columns: int) -> np.ndarray:
    """Return which cells of a map (rows, columns) over `area` the triangles reach into, bool.

    A cell counts if any part of it lies under a triangle, so no wall is too thin to be there. A
    triangle that stands upright is a line from above, and counts where the line runs.

    triangles: (n, 3, 2), world x and y of their corners, meters.
    """
    scale = np.array([columns, rows]) / area.size
    places = np.asarray(triangles, np.float64).reshape(-1, 3, 2)
    corners = (places - (area.x_min, area.y_min)) * scale
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    side = corners[:, 1] - corners[:, 0]
    other_side = corners[:, 2] - corners[:, 0]
    longest = np.maximum((side**2).sum(axis=1), (other_side**2).sum(axis=1))
    double_area = side[:, 0] * other_side[:, 1] - side[:, 1] * other_side[:, 0]
    upright = np.abs(double_area) <= 1e-9 * longest
    surfaces = np.zeros((rows, columns), bool)
    for cells, _, _ in _pairs(corners[~upright], rows, columns):
        surfaces[cells[:, 1], cells[:, 0]] = True
    lines = np.zeros_like(surfaces)
    for cells, touches, along_y in _pairs(corners[upright], rows, columns):
        # a line on the border of two cells, such as the side of a block, covers neither of them
        # where one is covered already
        before = cells - np.where(along_y[:, None], (1, 0), (0, 1))
        needless = touches & (before >= 0).all(axis=1) & surfaces[before[:, 1], before[:, 0]]
        lines[cells[~needless, 1], cells[~needless, 0]] = True
    return surfaces | lines


def _pairs(
    corners: np.ndarray, rows: int, columns: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the cells that triangles overlap, some triangles at a time: (cells, touches, along_y).

    cells: (m, 2), columns and rows.
    touches: (m,) bool, whether the triangle is a line on the border of the cell.
    along_y: (m,) bool, whether that line runs along y.
    corners: (n, 3, 2), in cells.
    """
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    first = np.floor(low).clip(0, [columns, rows]).astype(np.intp)
    after = np.maximum(np.ceil(high), np.floor(low) + 1)
    after = after.clip(0, [columns, rows]).astype(np.intp)
    wide, deep = np.maximum(after - first, 0).T
    counts = wide * deep
    order = np.flatnonzero(counts)
    ends = np.cumsum(counts[order])
    begin = 0
    while begin < len(order):
        before = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, before + OVERLAPS, "right")))
        run = order[begin:end]
        triangle = np.repeat(run, counts[run])
        place = np.arange(len(triangle)) - np.repeat(
            np.cumsum(counts[run]) - counts[run], counts[run]
        )
        offset = np.stack([place % wide[triangle], place // wide[triangle]], axis=1)
        cells = first[triangle] + offset
        overlap, touches = _overlap(corners[triangle], cells)
        size = (high - low)[triangle]
        yield cells[overlap], touches[overlap], (size[:, 1] > size[:, 0])[overlap]
        begin = end


def _overlap(corners: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (overlap, touch), (m,) bool each, of triangles and cells whose bounds overlap.

    overlap: whether the triangle overlaps the cell. A triangle that is a line overlaps a cell that
        it touches.
    touch: whether it only touches the cell.

    By separating axes: the cell is off the triangle if all of it lies beyond one of its edges.

    corners: (m, 3, 2), in cells.
    cells: (m, 2), columns and rows.
    """
    local = corners - (cells[:, None] + 0.5)  # the cell is the square of half a side about 0
    overlap = np.ones(len(cells), bool)
    touch = np.zeros(len(cells), bool)
    for k in range(3):
        edge = local[:, (k + 1) % 3] - local[:, k]
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)
        along = np.einsum("mcd,md->mc", local, normal)
        least = along.min(axis=1)
        most = along.max(axis=1)
        reach = 0.5 * np.abs(normal).sum(axis=1)
        is_point = reach == 0  # such an edge separates nothing
        inside = (least < reach) & (most > -reach) | is_point
        is_line = most - least <= 1e-9 * reach
        on_border = ~inside & is_line & (least <= reach) & (most >= -reach)
        overlap &= inside | on_border
        touch |= on_border
    return overlap, touch


def section(points: np.ndarray, triangles: np.ndarray, z: float) -> np.ndarray:
    """Return the lines in which triangles meet the level plane at the height `z`.

    They are (k, 2, 2) float64, the segments' ends (x, y).

    points: (n, 3) float64; triangles: (m, 3) indices.
    A point in the plane counts as above it. So the lines of a closed surface are closed.
    """
    corners = points[triangles]
    above = corners[..., 2] >= z
    crossed = above != np.roll(above, -1, axis=1)  # of each side
    through = crossed.any(axis=1)  # then two sides are
    begin = corners[through][crossed[through]]
    end = np.roll(corners[through], -1, axis=1)[crossed[through]]
    # from below, so that neighbors find the same point
    down = (begin[:, 2] >= z)[:, None]
    low = np.where(down, end, begin)
    high = np.where(down, begin, end)
    part = (z - low[:, 2:]) / (high[:, 2:] - low[:, 2:])
    return (low + part * (high - low))[:, :2].reshape(-1, 2, 2)
