"""The silhouette error: how far a LOD's outline lies from the character's in the picture, rendered from all around."""

import numpy as np

from . import raster
from .camera import Camera

AROUND, ABOVE = 8, 4  # directions at eye level, and from ABOVE_DEGREES above it
ABOVE_DEGREES = 35.0
FINER = 4  # pixels of the masks across a pixel of the picture, and across the error that is expected, if that is less
MOST_PIXELS = 1500  # of a mask's side: a larger one is rendered coarser


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


def shift(one: np.ndarray, other: np.ndarray) -> float:
    """The largest distance in pixels, between centres, from a pixel that one mask covers and the other does not, to the
    nearest that the other covers: how far the outline of one lies outside the other's. Masks: (rows, columns) bool.

    It is the Hausdorff distance of the two areas, not of their outlines: where a gap closes that is narrower than a pixel,
    no outline moves by more than half of it, while the gap's own outline may be anywhere else. Infinite for one empty mask.
    """
    return max(_farthest(one & ~other, other), _farthest(other & ~one, one))


def _farthest(pixels: np.ndarray, area: np.ndarray) -> float:
    """The largest distance from one of `pixels` to the nearest of `area`, both (rows, columns) bool."""
    if not pixels.any():
        return 0.0
    if not area.any():
        return np.inf
    along = _along_rows(area)
    row, column = np.nonzero(pixels)
    best = along[row, column] ** 2
    for step in range(1, len(area)):
        rest = np.flatnonzero(best > step * step)
        if not len(rest):
            break
        for side in (row[rest] - step, row[rest] + step):
            inside = (side >= 0) & (side < len(area))
            at = rest[inside]
            best[at] = np.minimum(best[at], along[side[inside], column[at]] ** 2 + step * step)
    return float(np.sqrt(best.max()))


def _along_rows(area: np.ndarray) -> np.ndarray:
    """(rows, columns) float64: the distance to the nearest pixel of `area` in the same row, infinite without one."""
    place = np.broadcast_to(np.arange(area.shape[1], dtype=np.float64), area.shape)
    left = np.maximum.accumulate(np.where(area, place, -np.inf), axis=1)
    right = np.minimum.accumulate(np.where(area, place, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.minimum(place - left, right - place)


def error(one: tuple, other: tuple, centre: np.ndarray, distance: float, camera: Camera, expected: float = 1.0) -> float:
    """Pixels of the picture: the largest `shift` between two surfaces' silhouettes over all `directions`.

    one, other: (points (n, 3) metres, triangles (m, 3)); the camera looks at centre (3,) from `distance` metres, and must
    be outside both. expected: about how many pixels it will be. This holds to about 1.5 pixels of the masks, which are FINER
    than the picture, and than what is expected, but coarser for more than FINER, and up to MOST_PIXELS.
    """
    worst, wanted = 0.0, FINER / min(max(expected, 1e-6), 1.0) / max(np.sqrt(expected) / 2, 1.0)
    for towards in directions():
        seen = [project(points, centre, towards, distance, camera)[:, :2] for points, _ in (one, other)]
        low = np.minimum(*(each.min(axis=0) for each in seen))
        extent = np.maximum(*(each.max(axis=0) for each in seen)) - low
        finer = min(wanted, MOST_PIXELS / max(extent.max(), 1.0))
        columns, rows = (np.ceil(extent * finer) + 1).astype(int)
        masks = [
            _mask(((at - low) * finer)[triangles], (rows, columns)) for at, (_, triangles) in zip(seen, (one, other), strict=True)
        ]
        worst = max(worst, shift(*masks) / finer)
    return worst


def _mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The silhouette of triangles, see raster.mask, with those that are seen edge on: a sheet that one shows so, and the other
    slantwise, is no error of its width."""
    mask = raster.mask(corners, shape)
    mask[raster.edges(corners, shape)] = True
    return mask
