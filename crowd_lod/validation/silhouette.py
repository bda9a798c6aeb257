"""The silhouette error: how far a LOD's outline lies from the character's in the picture, rendered from all around."""

import numpy as np

from ..culling.camera import Camera
from ..simplification import rasterizer

AROUND, ABOVE = 8, 4  # directions at eye level, and from ABOVE_DEGREES above it
ABOVE_DEGREES = 35.0
MASK_PIXELS = 4  # pixels of the masks across a pixel of the picture, and across the error that is expected, if that is less
MOST_PIXELS = 1500  # of a mask's side: a larger one is rendered coarser
# Pixels by which a distance between masks errs at most: a point of an area lies within 1.5 pixels of the centre of a pixel of its
# mask, and each such centre within 0.71 of a point of the area.
ERROR = 2.2
NEAR = 15  # times that error: more is not looked at closer
CLOSER, TILE, MOST_TILES = 12, 48, 12  # times finer, at most, where outlines are farthest apart, in tiles of so many pixels


def directions() -> np.ndarray:
    """(AROUND + ABOVE, 3) unit vectors from the character to the camera."""
    level = 2 * np.pi * np.arange(AROUND) / AROUND
    raised = 2 * np.pi * (np.arange(ABOVE) + 0.5) / ABOVE
    azimuth, elevation = np.append(level, raised), np.radians([0.0] * AROUND + [ABOVE_DEGREES] * ABOVE)
    return np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1)


def project(points: np.ndarray, centre: np.ndarray, towards: np.ndarray, distance: float, camera: Camera) -> np.ndarray:
    """(n, 3): x right and y up in pixels from the picture's middle, depth in metres, of points (n, 3) seen by a camera
    with the lens of `camera` that looks at `centre` (3,) from `distance` metres in the direction `towards` (3,)."""
    right = np.array([-towards[1], towards[0], 0.0])
    right = right / np.linalg.norm(right)
    v = points - centre
    depth = distance - v @ towards
    scale = camera.pixels_per_unit / (1.0 if camera.kind == "ORTHO" else depth)
    return np.stack([v @ right * scale, v @ np.cross(towards, right) * scale, depth], axis=1)


def outline_distance(one: np.ndarray, other: np.ndarray) -> float:
    """The largest distance in pixels, between centres, from a pixel that one mask covers and the other does not, to the
    nearest that the other covers: how far the outline of one lies outside the other's. Masks: (rows, columns) bool.

    It is the Hausdorff distance of the two areas, not of their outlines: where a gap closes that is narrower than a pixel,
    no outline moves by more than half of it, while the gap's own outline may be anywhere else. Infinite for one empty mask.
    """
    return float(max(_off(*pair)[2].max(initial=0.0) for pair in ((one, other), (other, one))))


def _off(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row (k,), column (k,), distance (k,) to the nearest pixel of `other`) of the pixels of `one` that `other` has not."""
    row, column = np.nonzero(one & ~other)
    if not len(row) or not other.any():
        return row, column, np.full(len(row), np.inf)
    along = _along_rows(other)
    best = along[row, column] ** 2
    for step in range(1, len(other)):
        rest = np.flatnonzero(best > step * step)
        if not len(rest):
            break
        for side in (row[rest] - step, row[rest] + step):
            inside = (side >= 0) & (side < len(other))
            at = rest[inside]
            best[at] = np.minimum(best[at], along[side[inside], column[at]] ** 2 + step * step)
    return row, column, np.sqrt(best)


def _along_rows(area: np.ndarray) -> np.ndarray:
    """(rows, columns) float64: the distance to the nearest pixel of `area` in the same row, infinite without one."""
    place = np.broadcast_to(np.arange(area.shape[1], dtype=np.float64), area.shape)
    left = np.maximum.accumulate(np.where(area, place, -np.inf), axis=1)
    right = np.minimum.accumulate(np.where(area, place, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.minimum(place - left, right - place)


def error(
    one: tuple, other: tuple, centre: np.ndarray, distance: float, camera: Camera, expected: float = 1.0
) -> tuple[float, float]:
    """Between which two numbers of pixels of the picture the largest `outline_distance` between two surfaces' silhouettes over all
    `directions` lies.

    one, other: (points (n, 3) metres, triangles (m, 3)); the camera looks at centre (3,) from `distance` metres, and must
    be outside both. expected: about how many pixels it will be. Masks are MASK_PIXELS than the picture, and than what is expected, but
    coarser for more than MASK_PIXELS, and up to MOST_PIXELS; where outlines are farthest apart, up to CLOSER times finer.
    """
    least = most = 0.0
    wanted = MASK_PIXELS / min(max(expected, 1e-6), 1.0) / max(np.sqrt(expected) / 2, 1.0)
    for towards in directions():
        flat = [project(points, centre, towards, distance, camera)[:, :2][triangles] for points, triangles in (one, other)]
        low = np.minimum(*(each.min(axis=(0, 1)) for each in flat))
        extent = np.maximum(*(each.max(axis=(0, 1)) for each in flat)) - low
        finer = min(wanted, MOST_PIXELS / max(extent.max(), 1.0))
        flat = [(each - low) * finer for each in flat]
        columns, rows = (np.ceil(extent * finer) + 1).astype(int)
        masks = [_mask(each, (rows, columns)) for each in flat]
        for k in range(2):
            found = _interval(flat[k], flat[1 - k], masks[k], masks[1 - k], least * finer)
            least, most = (max(pair) for pair in zip((least, most), (each / finer for each in found), strict=True))
    return least, most


def _interval(one: np.ndarray, other: np.ndarray, mask: np.ndarray, other_mask: np.ndarray, least: float) -> tuple[float, float]:
    """(least, most) pixels that the area of triangles `one` (m, 3, 2) reaches out of that of `other`, whose masks are these. Where
    it is more than `least`, the farthest places are looked at closer."""
    row, column, off = _off(mask, other_mask)
    most = off.max(initial=0.0)
    if not most or most + ERROR <= least or most > NEAR * ERROR:
        return max(most - ERROR, 0.0), most and most + ERROR
    far = np.stack([column, row], axis=1)[off > most - 2 * ERROR]
    tiles, of_tile = np.unique(far // TILE, axis=0, return_inverse=True)
    if len(tiles) > MOST_TILES:
        return max(most - ERROR, 0.0), most + ERROR
    margin, closest = int(np.ceil(most + 2 * ERROR)), 0.0
    size = TILE + 2 * margin
    closer = max(2, min(CLOSER, MOST_PIXELS // size))
    around = np.stack(np.meshgrid(range(-2, 3), range(-2, 3)), axis=-1).reshape(-1, 1, 2)
    for k, tile in enumerate(tiles * TILE):
        windows = []
        for each in (one, other):
            each = each - (tile - margin)
            inside = ((each.max(axis=1) >= 0) & (each.min(axis=1) <= size)).all(axis=1)
            windows.append(_mask(each[inside] * closer, (size * closer, size * closer)))
        near = np.zeros((size, size), bool)  # only the places that are farthest, and what lies about them
        x, y = (far[of_tile.ravel() == k] - tile + margin + around).reshape(-1, 2).T.clip(0, size - 1)
        near[y, x] = True
        windows[0] &= near.repeat(closer, axis=0).repeat(closer, axis=1)
        closest = max(closest, _off(*windows)[2].max(initial=0.0) / closer)
    return max(closest - ERROR / closer, 0.0), max(closest + ERROR / closer, most - ERROR)


def _mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The silhouette of triangles, see raster.mask, with those that are seen edge on: a sheet that one shows so, and the other
    slantwise, is no error of its width."""
    mask = rasterizer.mask(corners, shape)
    mask[rasterizer.edges(corners, shape)] = True
    return mask
