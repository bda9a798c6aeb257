"""How much of a picture a crowd covers, roughly."""

import numpy as np

from .camera import Camera

CELLS = 32  # of a grid along the longer side of the picture
COVERS = 0.15  # part of the square about its bounding sphere that a character covers
SMALL = 0.5  # cells: of agents with smaller spheres, as many as MOST stand for all
MOST = 20_000


def covered_pixels(camera: Camera, places: np.ndarray, radius: np.ndarray) -> float:
    """Return roughly how many pixels of the camera's picture agents cover.

    What an agent covers is spread evenly over the cells that its sphere meets. In a cell agents lie
    at random, so what they leave free falls exponentially. A panorama is one cell.
    places: (3, m) float64 meters, from the camera to the centers of the agents' bounding spheres.
    radius: (m,) float64 meters, of these.
    """
    picture = float(np.prod(camera.pixels))
    if camera.kind == "PANO":
        depth = np.linalg.norm(places, axis=0)
    else:
        depth = np.ones(len(radius)) if camera.kind == "ORTHO" else camera.Z @ places
    depth = depth if camera.kind == "ORTHO" else np.maximum(depth, radius)
    halves = radius * (camera.pixels_per_unit / depth)  # of the squares' sides, pixels
    if camera.kind == "PANO":
        cell = picture
        amounts = COVERS * ((2 * halves) ** 2).sum()
    else:
        side = max(camera.pixels) / CELLS
        cell = side**2
        agents, weight = _sample(halves, SMALL * side)
        centers = centers_in_picture(camera, places[:, agents] / depth[agents])
        amounts = _amounts(centers, halves[agents], weight, camera.pixels, side)
    return min(float((cell * -np.expm1(-amounts / cell)).sum()), picture)


def _sample(halves: np.ndarray, small: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (indices of agents that stand for all, how many each stands for).

    halves: (m,) pixels; small: pixels, below which agents stand for others.
    """
    is_small = halves < small
    others = np.flatnonzero(is_small)
    step = len(others) // MOST + 1
    agents = np.concatenate([np.flatnonzero(~is_small), others[::step]])
    return agents, np.where(is_small[agents], float(step), 1.0)


def centers_in_picture(camera: Camera, slopes: np.ndarray) -> np.ndarray:
    """Return where `slopes` (3, m) are in the picture, (2, m) pixels from its lower left."""
    w = camera.window
    (width, height) = camera.pixels
    return np.stack(
        [
            (camera.X @ slopes - w.left) * (width / (w.right - w.left)),
            (camera.Y @ slopes - w.bottom) * (height / (w.top - w.bottom)),
        ]
    )


def _amounts(
    centers: np.ndarray,
    halves: np.ndarray,
    weight: np.ndarray,
    picture: tuple[int, int],
    side: float,
) -> np.ndarray:
    """Return the pixels that agents cover in each cell, (rows, columns), as if none hid another.

    picture: its pixels; side: pixels of a cell.
    """
    columns, rows = (int(np.ceil(pixels / side)) for pixels in picture)
    first = np.floor((centers - halves) / side)
    last = np.floor((centers + halves) / side) + 1
    amount = weight * COVERS * (2 * halves) ** 2 / (last - first).prod(axis=0)
    # a table of which sums along both sides are the amounts: four corners of each square
    table = np.zeros((rows + 1) * (columns + 1))
    ends = [np.clip(end.T, 0, (columns, rows)).astype(np.intp).T for end in (first, last)]
    for (x, _), of_x in zip(ends, (1, -1), strict=True):
        for (_, y), of_y in zip(ends, (1, -1), strict=True):
            table += np.bincount(y * (columns + 1) + x, of_x * of_y * amount, len(table))
    sums = table.reshape(rows + 1, columns + 1).cumsum(axis=0).cumsum(axis=1)
    return sums[:-1, :-1].clip(0.0)
