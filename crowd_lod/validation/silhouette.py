"""The silhouette error: how far a LOD's outline lies from the character's.

It is measured in pixels of the picture, in masks rendered from all around.
"""

import numpy as np

from ..culling.camera import Camera
from ..simplification.triangle_mesh import ranges

EDGE = 1e-9  # pixels by which a center may miss an edge that it lies on, by rounding
# directions at eye level, and from ABOVE_DEGREES above it
AROUND = 8
ABOVE = 4
ABOVE_DEGREES = 35.0
# pixels of the masks across a pixel of the picture, and across the error that is expected, if that
# is less
MASK_PIXELS = 4
MOST_PIXELS = 1500  # of a mask's side: a larger one is rendered coarser
# Pixels by which a distance between masks errs at most: a point of an area lies within 1.5 pixels
# of the center of a pixel of its mask, and each such center within 0.71 of a point of the area.
ERROR = 2.2
NEAR = 15  # times that error: more is not looked at closer
# times finer, at most, where outlines are farthest apart, in tiles of so many pixels
CLOSER = 12
TILE = 48
MOST_TILES = 12
BESIDE = 2  # pixels about these places that are looked at, too


def directions() -> np.ndarray:
    """Return (AROUND + ABOVE, 3) unit vectors from the character to the camera."""
    level = 2 * np.pi * np.arange(AROUND) / AROUND
    raised = 2 * np.pi * (np.arange(ABOVE) + 0.5) / ABOVE
    azimuth = np.append(level, raised)
    elevation = np.radians([0.0] * AROUND + [ABOVE_DEGREES] * ABOVE)
    return np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        axis=1,
    )


def project(
    points: np.ndarray, center: np.ndarray, towards: np.ndarray, distance: float, camera: Camera
) -> np.ndarray:
    """Return points as a camera sees them: (n, 3), pixels right and up, and depth.

    Pixels count from the picture's middle; depth is in meters. The camera has the lens of `camera`
    and looks at `center` (3,) from `distance` meters in the direction `towards` (3,).
    points: (n, 3) meters.
    """
    right = np.array([-towards[1], towards[0], 0.0])
    right = right / np.linalg.norm(right)
    v = points - center
    depth = distance - v @ towards
    scale = camera.pixels_per_unit / (1.0 if camera.kind == "ORTHO" else depth)
    return np.stack([v @ right * scale, v @ np.cross(towards, right) * scale, depth], axis=1)


def outside(
    mask: np.ndarray, other_mask: np.ndarray, farthest: float = np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, column, distance to `other_mask`), each (k,), of pixels in `mask` only.

    Distances above `farthest` are too large, or infinite.
    """
    row, column = np.nonzero(mask & ~other_mask)
    if not len(row) or not other_mask.any():
        return row, column, np.full(len(row), np.inf)
    along = _along_rows(other_mask)
    best = along[row, column] ** 2
    for step in range(1, len(other_mask)):
        rest = np.flatnonzero(best > step * step)
        if not len(rest) or step > farthest:
            break
        for side in (row[rest] - step, row[rest] + step):
            inside = (side >= 0) & (side < len(other_mask))
            at = rest[inside]
            best[at] = np.minimum(best[at], along[side[inside], column[at]] ** 2 + step * step)
    return row, column, np.sqrt(best)


def _along_rows(area: np.ndarray) -> np.ndarray:
    """Return the distance to the nearest pixel of `area` in the same row, else inf."""
    place = np.broadcast_to(np.arange(area.shape[1], dtype=np.float64), area.shape)
    left = np.maximum.accumulate(np.where(area, place, -np.inf), axis=1)
    right = np.minimum.accumulate(np.where(area, place, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.minimum(place - left, right - place)


def error(
    surface: tuple,
    other_surface: tuple,
    center: np.ndarray,
    distance: float,
    camera: Camera,
    expected: float = 1.0,
) -> tuple[float, float]:
    """Return (least, most), in pixels, between which the silhouette error lies.

    The error is the largest distance from one silhouette to the other, both ways,
    over all `directions`: the Hausdorff distance of the areas, not of their outlines.
    surface, other_surface: (points (n, 3) meters, triangles (m, 3)).
    center: (3,), the point that the camera looks at.
    distance: meters from the camera to it. The camera must be outside both surfaces.
    expected: about how many pixels the error will be.
    Masks have MASK_PIXELS pixels across a pixel of the picture; across the expected error, if that
    is less; coarser for an expected error above MASK_PIXELS. A side has MOST_PIXELS at most. Where
    outlines are farthest apart, they are up to CLOSER times finer.
    """
    least = most = 0.0
    resolution = MASK_PIXELS / min(max(expected, 1e-6), 1.0) / max(np.sqrt(expected) / 2, 1.0)
    for towards in directions():
        corners_of = [
            project(points, center, towards, distance, camera)[:, :2][triangles]
            for points, triangles in (surface, other_surface)
        ]
        low = np.minimum(*(corners.min(axis=(0, 1)) for corners in corners_of))
        extent = np.maximum(*(corners.max(axis=(0, 1)) for corners in corners_of)) - low
        finer = min(resolution, MOST_PIXELS / max(extent.max(), 1.0))
        corners_of = [(corners - low) * finer for corners in corners_of]
        columns, rows = (np.ceil(extent * finer) + 1).astype(int)
        masks = [silhouette_mask(corners, (rows, columns)) for corners in corners_of]
        for k in range(2):
            interval = _interval(
                corners_of[k], corners_of[1 - k], masks[k], masks[1 - k], least * finer
            )
            least, most = (
                max(pair)
                for pair in zip(
                    (least, most), (corners / finer for corners in interval), strict=True
                )
            )
    return least, most


def _interval(
    area: np.ndarray, other_area: np.ndarray, mask: np.ndarray, other_mask: np.ndarray, least: float
) -> tuple[float, float]:
    """Return (least, most) pixels by which `area` reaches out of `other_area`.

    If it may reach out by more than `least`, the farthest places are examined more finely.
    area, other_area: (m, 3, 2), corners of triangles. mask, other_mask: theirs.
    """
    row, column, off = outside(mask, other_mask)
    most = off.max(initial=0.0)
    if not most or most + ERROR <= least or most > NEAR * ERROR:
        return max(most - ERROR, 0.0), most and most + ERROR
    farthest = off > most - 2 * ERROR
    far = np.stack([column, row], axis=1)[farthest]
    tiles, of_tile = np.unique(far // TILE, axis=0, return_inverse=True)
    if len(tiles) > MOST_TILES:
        return max(most - ERROR, 0.0), most + ERROR
    of_tile = of_tile.ravel()
    reach = np.zeros(len(tiles))
    np.maximum.at(reach, of_tile, off[farthest])
    margin = int(np.ceil(most + 2 * ERROR))
    closest = 0.0
    closer = max(2, min(CLOSER, MOST_PIXELS // (TILE + 2 * margin)))
    for k in np.argsort(-reach):
        if reach[k] + ERROR <= max(closest, least):
            break
        closest = max(closest, _look(area, other_area, far[of_tile == k], margin, closer))
    return max(closest - ERROR / closer, 0.0), max(closest + ERROR / closer, most - ERROR)


def _look(
    area: np.ndarray, other_area: np.ndarray, places: np.ndarray, margin: int, closer: int
) -> float:
    """Return the pixels by which `area` reaches out of `other_area` about `places`.

    area, other_area: (m, 3, 2), corners of triangles. places: (n, 2) int, pixels: column, row.
    margin: pixels about the places in which the nearest of `other_area` is. closer: how many times
    finer than a pixel is looked.
    """
    low = places.min(axis=0) - BESIDE - margin
    size = places.max(axis=0) + BESIDE + margin + 1 - low
    columns, rows = size
    windows = []
    for corners in (area, other_area):
        corners = corners - low
        inside = ((corners.max(axis=1) >= 0) & (corners.min(axis=1) <= size)).all(axis=1)
        windows.append(silhouette_mask(corners[inside] * closer, (rows * closer, columns * closer)))
    beside = range(-BESIDE, BESIDE + 1)
    around = np.stack(np.meshgrid(beside, beside), axis=-1).reshape(-1, 1, 2)
    x, y = (places - low + around).reshape(-1, 2).T
    near = np.zeros((rows, columns), bool)
    near[y, x] = True
    windows[0] &= near.repeat(closer, axis=0).repeat(closer, axis=1)
    return outside(windows[0], windows[1])[2].max(initial=0.0) / closer


def silhouette_mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the silhouette of triangles, with those that are seen edge on.

    Otherwise a sheet that one mesh shows edge on and the other at a slant would count as an error
    of the sheet's width.
    """
    covered = mask(corners, shape)
    covered[edge_pixels(corners, shape)] = True
    return covered


def mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The pixels that triangles cover, (rows, columns) bool.

    Each triangle covers a row from where it begins in it to where it ends; centers on edges are
    covered. Triangles seen edge on cover nothing.
    corners: (m, 3, 2) float64, in pixels: x from the left edge, y from the edge of row 0. shape:
    rows and columns.
    """
    rows, columns = shape
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    x, y = corners[u[:, 0] * v[:, 1] != u[:, 1] * v[:, 0]].transpose(2, 1, 0)
    low = np.ceil(y.min(axis=0) - 0.5).clip(0, rows)
    high = (np.floor(y.max(axis=0) - 0.5) + 1).clip(0, rows)
    count = (high - low).clip(0).astype(np.intp)
    # each triangle in each of its rows
    triangle = np.repeat(np.arange(len(count)), count)
    row = ranges(low.astype(np.intp), count)
    begin = np.full(len(row), np.inf)
    end = np.full(len(row), -np.inf)
    for p, q in ((0, 1), (1, 2), (2, 0)):
        (x_p, y_p), (x_q, y_q) = ((x[k].take(triangle), y[k].take(triangle)) for k in (p, q))
        crossed = np.flatnonzero(((y_p - row - 0.5) * (y_q - row - 0.5) <= 0) & (y_p != y_q))
        part = (row[crossed] + 0.5 - y_p[crossed]) / (y_q[crossed] - y_p[crossed])
        at = x_p[crossed] + part * (x_q[crossed] - x_p[crossed])
        begin[crossed] = np.minimum(begin[crossed], at)
        end[crossed] = np.maximum(end[crossed], at)
    first = np.ceil(begin - 0.5 - EDGE).clip(0, columns).astype(np.intp)
    last = (np.floor(end - 0.5 + EDGE) + 1).clip(0, columns).astype(np.intp)
    spans = np.flatnonzero(first < last)
    # how many begin less how many have ended
    begun, ended = (
        np.bincount(row[spans] * (columns + 1) + ends[spans], minlength=rows * (columns + 1))
        for ends in (first, last)
    )
    return np.cumsum((begun - ended).reshape(rows, columns + 1), axis=1, dtype=np.int32)[:, :-1] > 0


def edge_pixels(corners: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The pixels along the longest edges of triangles less than a pixel high.

    `mask` may miss parts of such: what is seen edge on. corners, shape: see `mask`; what lies
    outside is moved to the border. Returns rows (k,) and columns (k,).
    """
    sides = np.roll(corners, -1, axis=1) - corners
    squares = np.einsum("mkd,mkd->mk", sides, sides)
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    low = np.flatnonzero(doubled**2 < squares.max(axis=1, initial=0))
    first = squares[low].argmax(axis=1)
    begin = corners[low, first]
    side = sides[low, first]
    count = np.ceil(np.abs(side).max(axis=1, initial=0)).astype(np.intp) + 1
    part = ranges(np.zeros_like(count), count) / np.repeat((count - 1).clip(1), count)
    at = np.repeat(begin, count, axis=0) + part[:, None] * np.repeat(side, count, axis=0)
    column, row = np.floor(at).astype(np.intp).clip(0, (shape[1] - 1, shape[0] - 1)).T
    return row, column
