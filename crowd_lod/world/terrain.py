"""Terrain: the ground that a crowd stands on, from the triangles of meshes, on several floors.

Triangles are sorted once, seen from above, into cells. A look-up asks the triangles of its cell
alone, and takes the height of their plane: it is exact on ramps, and steps of stairs stay steps.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import CrowdError
from ..progress import check_cancelled
from .height_map import LOOK_UPS, HeightMap, lean

# Meters that an agent steps up at once.
STEP = 0.5
# Meters: nobody starts where another floor is closer above than this, as within stairs.
HEADROOM = 1.8
# Meters: a gap in the ground that is narrower does not count, nor does a narrower triangle.
CLOSE = 1e-4
STEEP = 1.0  # rise over run: on steeper ground nobody leans
MOST_CELLS = 2**21
NEXT = [1, 2, 0]  # of each corner of a triangle, the next one
PAIRS = 2**19  # triangles and cells that are compared at a time


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground of triangles, which may lie over each other.

    An agent stands on the highest floor at most STEP above its last height, or else on the lowest.
    Floors less than STEP apart are one, the upper of them: nobody fits between.

    corners: (m, 3, 3) float64, world space: of each triangle three points (x, y, z). See upward.
    z: the height where there is no triangle.
    meters: in a unit of length, for STEP, HEADROOM and CLOSE.
    CrowdError if there is no triangle, or a point at NaN or infinity.
    """

    corners: np.ndarray
    z: float = 0.0
    meters: float = 1.0

    def __post_init__(self) -> None:
        if not len(self.corners):
            raise CrowdError(
                "The terrain has no face that one can stand on: give it a mesh with faces that "
                "are not upright."
            )
        if not np.isfinite(self.corners).all():
            wrong = int((~np.isfinite(self.corners).all(axis=2)).sum())
            raise CrowdError(
                f"The terrain has {wrong} corners at NaN or infinity: mend its mesh or its "
                "modifiers."
            )

    @cached_property
    def span(self) -> tuple[float, float]:
        """The least and the greatest world z of the ground, and of where there is none."""
        heights = self.corners[:, :, 2]
        return min(self.z, float(heights.min())), max(self.z, float(heights.max()))

    @cached_property
    def steepest(self) -> tuple[float, float]:
        """The greatest slopes along x and along y that agents lean on, as rises over runs."""
        slopes = np.abs(self._heights[:, :2])
        slopes = slopes[np.hypot(*slopes.T) <= STEEP]
        return float(slopes[:, 0].max(initial=0)), float(slopes[:, 1].max(initial=0))

    @cached_property
    def layered(self) -> bool:
        """Whether floors lie over each other, so that an agent's height follows from its last one.

        Where they do in a spot smaller than a cell, it may be overlooked; agents then are on the
        upper.
        """
        middles = self.corners[:, :, :2].mean(axis=1)
        rows, columns = np.divmod(np.flatnonzero(np.diff(self._cells[0]) > 1), self._grid[0])
        cells = self._low + (np.stack([columns, rows], axis=1) + 0.5) * self._size
        places = np.concatenate([middles, cells])
        for at in range(0, len(places), LOOK_UPS):
            check_cancelled()
            agents, _, z = self._over(*places[at : at + LOOK_UPS].T)
            if len(agents):
                begin = _begins(agents)
                highest = np.maximum.reduceat(z, begin)
                lowest = np.minimum.reduceat(z, begin)
                if (highest > _climb(z, begin, lowest, self._step)).any():
                    return True
        return False

    def at(self, x: np.ndarray, y: np.ndarray, last: np.ndarray | None = None) -> np.ndarray:
        """Return world z (n,) float64 of the ground at world positions x, y (n,).

        last: (n,) meters, where each agent stood before; None for the lowest floor.
        """
        z = np.full(len(x), float(self.z))
        for agents, height, _ in self._find_ground(x, y, last):
            z[agents] = height
        return z

    def start(self, x: np.ndarray, y: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return world z (n,) float64 of where agents spawn: as `at`, but with HEADROOM."""
        z = np.full(len(x), float(self.z))
        for agents, height, _ in self._find_ground(x, y, last, HEADROOM / self.meters):
            z[agents] = height
        return z

    def slope(
        self, x: np.ndarray, y: np.ndarray, last: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (dz/dx, dz/dy), each (n,) float64, of the ground at x, y (n,).

        0 where there is none.
        """
        slopes = np.zeros((2, len(x)))
        for agents, _, triangles in self._find_ground(x, y, last):
            slopes[:, agents] = self._heights[triangles, :2].T
        return slopes[0], slopes[1]

    def tilt(
        self, x: np.ndarray, y: np.ndarray, heading: np.ndarray, last: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (pitch, roll) of agents that stand at right angles to the ground.

        Both are as in height_map.lean.

        On ground steeper than STEEP they stand upright.
        """
        along_x, along_y = self.slope(x, y, last)
        gentle = np.hypot(along_x, along_y) <= STEEP
        return lean(along_x * gentle, along_y * gentle, heading)

    def missing(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return where there is no ground, (n,) bool, of x, y (n,)."""
        is_missing = np.ones(len(x), bool)
        for agents, _, _ in self._find_ground(x, y, None):
            is_missing[agents] = False
        return is_missing

    def prepare(self) -> None:
        """Make what look-ups need: seconds for a million triangles."""
        _ = self.layered, self._heights

    def digest(self) -> bytes:
        """Return all that the heights follow from."""
        return repr((self.z, self.meters)).encode() + self.corners.tobytes()

    @property
    def _step(self) -> float:
        return STEP / self.meters

    @property
    def _close(self) -> float:
        return CLOSE / self.meters

    def _find_ground(
        self, x: np.ndarray, y: np.ndarray, last: np.ndarray | None, room: float = 0.0
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield (agents (k,) intp, heights (k,), triangles (k,)) of those with ground under them.

        room: meters that must be free above a floor for an agent to stand on it; STEP at least.
        """
        for at in range(0, len(x), LOOK_UPS):
            block = slice(at, at + LOOK_UPS)
            entries, triangles, z = self._over(x[block], y[block])
            if not len(entries):
                continue
            begin = _begins(entries)
            agents = entries[begin]
            if len(agents) == len(entries):
                yield agents + at, z, triangles
                continue
            before = np.minimum.reduceat(z, begin) if last is None else last[block][agents]
            height = _climb(z, begin, before, self._step)
            if room > self._step:
                height = _climb(z, begin, height, room)
            # the first triangle of that height
            (same,) = np.nonzero(z == np.repeat(height, np.diff(begin, append=len(z))))
            yield agents + at, height, triangles[same[_begins(entries[same])]]

    def _over(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (agents, triangles, heights), each (k,), of all triangles under or over x, y (n,).

        They are listed agent by agent.
        """
        begin, of_cell = self._cells
        place = np.stack([x, y]) - self._low[:, None]
        far = (self._size * self._grid)[:, None] + self._close
        inside = ((place >= -self._close) & (place <= far)).all(axis=0)
        # at NaN any cell
        index = np.fmin(np.fmax(place / self._size[:, None], 0), self._grid[:, None] - 1)
        column, row = index.astype(np.intp)
        cell = row * self._grid[0] + column
        first = begin[cell]
        count = (begin[cell + 1] - first) * inside
        agents = np.repeat(np.arange(len(x)), count)
        offset = np.repeat(first - (np.cumsum(count) - count), count)
        triangles = of_cell[np.arange(len(agents)) + offset]
        sides = self._sides[triangles].T
        u, v = place[:, agents]
        within = np.ones(len(agents), bool)
        for a, b, c in (sides[:3], sides[3:6], sides[6:]):
            within &= a * u + b * v + c >= -self._close
        agents = agents[within]
        triangles = triangles[within]
        along_x, along_y, z, least, most = self._heights[triangles].T
        height = along_x * u[within] + along_y * v[within] + z
        return agents, triangles, np.clip(height, least, most)

    @cached_property
    def _low(self) -> np.ndarray:
        """The least x and y, (2,)."""
        return self.corners[:, :, :2].min(axis=(0, 1))

    @cached_property
    def _grid(self) -> np.ndarray:
        """Columns and rows of the cells, (2,) intp.

        There are about four cells a triangle, as square as can be.
        """
        width, depth = self._extent
        count = np.clip(4 * len(self.corners), 4096, MOST_CELLS)
        columns = np.clip(np.sqrt(count * width / depth), 1, count)
        return np.array([np.ceil(columns), np.ceil(count / columns)], np.intp)

    @cached_property
    def _extent(self) -> np.ndarray:
        return np.maximum(self.corners[:, :, :2].max(axis=(0, 1)) - self._low, self._close)

    @cached_property
    def _size(self) -> np.ndarray:
        """Width and depth of a cell, (2,) meters."""
        return self._extent / self._grid

    @cached_property
    def _plan(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y, along, up, each (m, 3), of the triangles seen from above.

        These are the points from the least x and y on, and the ways to the next ones.
        """
        x = np.ascontiguousarray(self.corners[:, :, 0] - self._low[0])
        y = np.ascontiguousarray(self.corners[:, :, 1] - self._low[1])
        return x, y, x[:, NEXT] - x, y[:, NEXT] - y

    @cached_property
    def _sides(self) -> np.ndarray:
        """(m, 9) float64: (a, b, c) of each side; a u + b v + c is the distance from it.

        The distance is above 0 within the triangle.
        u, v: meters from the least x and y.
        """
        x, y, along, up = self._plan
        turn = np.where(_double_area(along, up) < 0, -1.0, 1.0)[:, None]
        way = turn / np.hypot(along, up)
        a = -up * way
        b = along * way
        return np.stack([a, b, -(a * x + b * y)], axis=2).reshape(-1, 9)

    @cached_property
    def _heights(self) -> np.ndarray:
        """(m, 5) float64: slopes along x and y, height at u = v = 0, least and greatest height."""
        x, y, along, up = self._plan
        z = self.corners[:, :, 2]
        rise = z[:, NEXT] - z
        double = _double_area(along, up)
        slope_x = (rise[:, 0] * up[:, 1] - up[:, 0] * rise[:, 1]) / double
        slope_y = (along[:, 0] * rise[:, 1] - rise[:, 0] * along[:, 1]) / double
        height = z[:, 0] - slope_x * x[:, 0] - slope_y * y[:, 0]
        columns = [slope_x, slope_y, height, z.min(axis=1), z.max(axis=1)]
        return np.stack(columns, axis=1)

    @cached_property
    def _cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (begin (cells + 1,) intp, triangles (k,) int32) that cells touch.

        Cell c is touched by triangles[begin[c]:begin[c + 1]].
        """
        plan = self.corners[:, :, :2] - self._low
        least = ((plan.min(axis=1) - self._close) / self._size).astype(np.intp)
        most = ((plan.max(axis=1) + self._close) / self._size).astype(np.intp)
        least = np.clip(least, 0, self._grid - 1)
        most = np.clip(most, 0, self._grid - 1)
        wide, high = (most - least + 1).T
        counts = wide * high
        ends = np.cumsum(counts)
        cells = []
        triangles = []
        since = 0
        while since < len(plan):
            check_cancelled()
            before = ends[since - 1] if since else 0
            until = max(int(np.searchsorted(ends, before + PAIRS, side="right")), since + 1)
            run = slice(since, until)
            triangle = np.repeat(np.arange(since, until), counts[run])
            first = ends[run] - counts[run] - before
            place = np.arange(len(triangle)) - np.repeat(first, counts[run])
            row, column = np.divmod(place, wide[triangle])
            row += least[triangle, 1]
            column += least[triangle, 0]
            touched = self._touched(triangle, row, column)
            cells.append((row * self._grid[0] + column)[touched])
            triangles.append(triangle[touched].astype(np.int32))
            since = until
        cell = np.concatenate(cells)
        count = np.bincount(cell, minlength=int(self._grid.prod()))
        order = np.argsort(cell, kind="stable")
        return np.append(0, np.cumsum(count)), np.concatenate(triangles)[order]

    def _touched(self, triangle: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return whether each triangle touches the cell beside it, (k,) bool.

        triangle, row, column: (k,) intp. The cell is one that the triangle's bounds overlap.
        """
        u, v = (np.stack([column, row]) + 0.5) * self._size[:, None]
        width, depth = self._size
        sides = self._sides[triangle].T
        touched = np.ones(len(triangle), bool)
        for a, b, c in (sides[:3], sides[3:6], sides[6:]):
            reach = (np.abs(a) * width + np.abs(b) * depth) / 2 + 2 * self._close
            touched &= a * u + b * v + c >= -reach
        return touched


def upward(corners: np.ndarray, meters: float = 1.0) -> np.ndarray:
    """Return which triangles of one object, `corners` (m, 3, 3), carry somebody, (m,) bool.

    Left out are upright ones, and those that face down: they are ceilings. If all face down, the
    mesh is taken for one that is inside out, and they count.

    meters: in a unit of length.
    """
    along = corners[:, NEXT, 0] - corners[:, :, 0]
    up = corners[:, NEXT, 1] - corners[:, :, 1]
    double = _double_area(along, up)
    longest = np.hypot(along, up).max(axis=1, initial=0)
    # triangles at NaN stay: Terrain refuses them
    wide = ~(np.abs(double) <= CLOSE / meters * longest)
    faces_up = ~(double < 0)
    return wide & faces_up if (wide & faces_up).any() else wide


def _double_area(along: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return twice the area of each triangle seen from above, (m,); below 0 where it faces down."""
    return along[:, 0] * up[:, 1] - up[:, 0] * along[:, 1]


def _begins(entries: np.ndarray) -> np.ndarray:
    """Return where each agent's entries begin in `entries` (k,), sorted agents."""
    return np.flatnonzero(np.append(True, entries[1:] != entries[:-1]))


def _climb(z: np.ndarray, begin: np.ndarray, last: np.ndarray, step: float) -> np.ndarray:
    """Return the height (a,) to which each agent climbs by steps up of at most `step`.

    z: (k,) heights of floors, agent by agent.
    begin: (a,) where each agent's begin.
    last: (a,) heights from which they climb.
    """
    lowest = np.minimum.reduceat(z, begin)
    count = np.diff(begin, append=len(z))
    while True:
        within_step = np.where(z <= np.repeat(last + step, count), z, -np.inf)
        height = np.maximum(np.maximum.reduceat(within_step, begin), lowest)
        if np.array_equal(height, last):
            return height
        last = height


# What a crowd may stand on. Both give heights, slopes and tilts at places.
Ground = HeightMap | Terrain
