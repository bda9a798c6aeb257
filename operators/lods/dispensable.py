"""Objects of a character that a LOD may leave out, as nobody sees that they are gone."""

from collections.abc import Sequence

import numpy as np

from ...crowd_lod.simplification.hausdorff import SurfacePoints, upper_distances
from .posed_surface import PosedSurface, parts_of
from .surface import merge

# An object may reach this far from what stands in for it, as part of the length that the LOD may
# deviate by.
REACH = 1.0


def find_dispensable(character: PosedSurface, length: float) -> np.ndarray:
    """Return which objects a LOD may leave out that deviates by `length` meters, (objects,) bool.

    Such an object is hidden, or it is no longer than twice the length and lies near one that
    stays, in all poses. Where small objects are near to each other alone, such as beads on a
    string, those stay that are near to most.
    """
    middles, sizes = _bounding_boxes(character)
    radii = sizes.max(axis=1) / 2
    surfaces = _Surfaces(character)
    hidden = np.array([not len(places.corners) for places in surfaces.places])
    small = np.flatnonzero((radii <= length) & ~hidden)
    large = np.flatnonzero((radii > length) & ~hidden)
    left = small[surfaces.distances(large, small) > REACH * length]
    apart = np.linalg.norm(middles[left, None] - middles[left], axis=2)
    stands_in = np.eye(len(left), dtype=bool)
    for number, item in enumerate(left):
        near = np.flatnonzero(apart[number] < radii[left] + radii[item] + length)
        stands_in[number, near] |= surfaces.distances([item], left[near]) <= REACH * length
    dispensable = hidden.copy()
    dispensable[small] = True
    dispensable[left[_cover(stands_in)]] = False
    return dispensable


def _cover(stands_in: np.ndarray) -> list[int]:
    """Choose few rows that together cover all columns: always the row that covers most of the rest.

    stands_in: (n, n) bool, its diagonal true.
    """
    left = np.ones(len(stands_in), bool)
    rows = []
    while left.any():
        row = int(np.where(left, stands_in[:, left].sum(axis=1), 0).argmax())
        rows.append(row)
        left &= ~stands_in[row]
    return rows


class _Surfaces:
    """The objects of a character in its poses, apart.

    places: of each object, what shows.
    """

    def __init__(self, character: PosedSurface):
        run = max(character.runs, key=len)
        first = character.shapes[run[0]]
        merged = character.surface(run)
        self.moving = merged.moving
        self.places = parts_of(merged, first)
        corners = merged.source[self.moving.triangles[:, 0]]
        self._owner = np.searchsorted(first.begins, corners, side="right") - 1
        # transparent surface, and what only some agents wear, stands in for nothing
        self._owner[~first.hiding[merged.with_area]] = -1

    def distances(self, owners: Sequence[int], objects: Sequence[int]) -> np.ndarray:
        """Return how far what shows of each of `objects` is from `owners` at most, in any pose.

        (objects,) meters, infinite where the others show no face.
        """
        points = list(self.moving.points.transpose(1, 0, 2))
        surface = merge(points, self.moving.triangles[np.isin(self._owner, owners)])
        if surface is None:
            return np.full(len(objects), np.inf)
        return np.array([self._distance(self.places[item], surface.moving) for item in objects])

    def _distance(self, places: SurfacePoints, other) -> float:
        return float(upper_distances(self.moving, other, places).max(initial=0.0))


def _bounding_boxes(character: PosedSurface) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (objects, 3) and sizes (objects, 3) of the objects, meters."""
    shape = character.shapes[max(character.runs, key=len)[0]]
    boxes = [
        (points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros((2, 3))
        for points in np.split(shape.points, shape.begins[1:-1])
    ]
    low, high = np.array(boxes).transpose(1, 0, 2)
    return (low + high) / 2, high - low
