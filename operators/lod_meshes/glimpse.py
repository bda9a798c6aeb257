"""A quick estimate of how far LODs lie off, object by object."""

from collections.abc import Generator, Sequence

import bpy
import numpy as np

from .deviation import Measure, Posed, _surface
from .surface import Surface

POSES = 4
POINTS = 1_000  # triangles between whose corners it is looked at


class Glimpse:
    """Estimates deviations of LODs of the character that `measure` reads."""

    def __init__(self, measure: Measure):
        self.measure = measure
        self.level = measure.level
        self.own: list[tuple[list, Surface]] = []

    def _read(self, items, frames):
        with Posed([], [[item] for item in items], self.measure.performance) as posed:
            for frame in frames:
                shapes = posed.shapes(frame)[1:]
                posed.performance.rest()
                surfaces = [_surface(*shape) for shape in shapes]
                whole = [surface for surface in surfaces if surface]
                counts = np.cumsum([0, *(len(surface.points) for surface in whole)])
                union = Surface(
                    np.concatenate([surface.points for surface in whole]),
                    np.concatenate([surface.triangles + at for surface, at in zip(whole, counts, strict=False)]),
                )
                yield surfaces, union

    def estimate(self, items: Sequence[bpy.types.Object]) -> Generator[float, None, list[float]]:
        yield from self.measure.read()
        frames = self.measure.frames
        frames = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, min(POSES, len(frames))).round().astype(int))]
        if not self.own:
            self.own = list(self._read(self.measure.objects, frames))
        found = np.zeros(len(items))
        for (mine, whole), (theirs, lod) in zip(self.own, self._read(items, frames), strict=True):
            for j, (one, other) in enumerate(zip(mine, theirs, strict=True)):
                for a, b in ((one, lod), (other, whole)):
                    if a is not None:
                        found[j] = max(found[j], _off(a, b))
            yield 0.0
        return found.tolist()


def _off(one: Surface, other: Surface) -> float:
    """Return about the largest distance from `one` to `other`, meters."""
    corners = other.distances(one.points)
    at = one.points[one.triangles]
    off = corners[one.triangles].max(axis=1)
    size = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).max(axis=1)
    most = corners.max()
    likely = np.flatnonzero(off + size / 2 > most)
    likely = likely[np.argsort(-(off + size / 2)[likely], kind="stable")[:POINTS]]
    at = at[likely]
    middles = np.concatenate([at.mean(axis=1)[:, None], (at + np.roll(at, -1, axis=1)) / 2], axis=1)
    return float(max(most, other.distances(middles.reshape(-1, 3)).max(initial=0)))
