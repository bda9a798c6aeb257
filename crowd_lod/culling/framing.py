"""Where a camera stands that frames a crowd over a shot."""

from dataclasses import dataclass

import numpy as np

EYE = 1.7  # meters above the ground
BODY = 1.0  # meters above it, of the part of people that the picture holds
CELL = 2.0  # meters, of the grid that finds where the crowd is densest
WAYS = 32  # directions that are tried
SEEN = 0.95  # part of the places that the picture holds at least
NEAREST = 3.0  # meters between the camera and the place that it looks at, at least


@dataclass(frozen=True)
class LevelCamera:
    """A camera that stands upright and looks level.

    eye: (3,) float64, world meters.
    ahead: (2,) float64, the unit vector along x and y in which it looks.
    far: meters along it, beyond everyone.
    """

    eye: np.ndarray
    ahead: np.ndarray
    far: float


def framing(places: np.ndarray, across: float, below: float, above: float) -> LevelCamera:
    """Return the view over the densest of `places` that holds most of them from the least distance.

    places: (n, 3) float64, n > 0, world meters: the feet of all agents at several times.
    across, below, above: slopes of the picture's sides, of its bottom and of its top, all above 0.
    """
    middle = _densest(places)
    x, y, z = (places - middle).T
    turn = np.arange(WAYS) * (2 * np.pi / WAYS)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    distances = np.empty(WAYS)
    for k, (cos, sin) in enumerate(ways):
        ahead = cos * x + sin * y
        aside = cos * y - sin * x
        needed = np.maximum.reduce(
            [np.abs(aside) / across, (z + BODY - EYE) / above, (EYE - BODY - z) / below]
        )
        distances[k] = np.quantile(needed - ahead, SEEN, method="higher")
    best = int(distances.argmin())
    way = ways[best]
    away = max(float(distances[best]), NEAREST)
    eye = middle + np.array([*(-away * way), EYE])
    far = float(((places[:, :2] - eye[:2]) @ way).max())
    return LevelCamera(eye, way, 1.1 * max(far, away) + NEAREST)


def _densest(places: np.ndarray) -> np.ndarray:
    """Return the middle (3,) of the places in the fullest cell of a grid, on their usual height."""
    cell = np.floor((places[:, :2] - places[:, :2].min(axis=0)) / CELL).astype(np.int64)
    number = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    _, which, counts = np.unique(number, return_inverse=True, return_counts=True)
    inside = places[which == counts.argmax()]
    return np.array([*inside[:, :2].mean(axis=0), np.median(inside[:, 2])])
