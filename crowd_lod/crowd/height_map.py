"""Height maps: the ground's height over an area, and how agents lean on its slopes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import CrowdError
from .maps import Area

# Agents that are looked up at a time: their columns stay in the processor's cache.
LOOK_UPS = 8192


@dataclass(frozen=True)
class HeightMap:
    """Heights over an area; the ground is bilinear between them.

    heights: (rows, columns) float32, meters above the area's z, at the middles of the pixels. Row 0
        lies at y_min, column 0 at x_min, as in LabelMap.
    From the outermost middles to the area's border, and beyond it, the ground continues level.
    CrowdError if a height is NaN or infinite.
    """

    heights: np.ndarray
    area: Area
    layered = False  # there is one floor

    def __post_init__(self) -> None:
        wrong = np.argwhere(~np.isfinite(self.heights))
        if len(wrong):
            row, column = wrong[0]
            raise CrowdError(
                f"The height map holds {len(wrong)} values at NaN or infinity, the first at "
                f"column {column}, row {row} from "
                "the bottom: paint a height there."
            )

    def digest(self) -> bytes:
        """Return all that the heights follow from, but for the area."""
        return repr(self.heights.shape).encode() + self.heights.tobytes()

    @cached_property
    def span(self) -> tuple[float, float]:
        """The least and the greatest world z of the ground."""
        return self.area.z + float(self.heights.min()), self.area.z + float(self.heights.max())

    @cached_property
    def steepest(self) -> tuple[float, float]:
        """The greatest slopes of the ground along x and along y, as rises over runs."""
        rows, columns = self.heights.shape
        width, depth = self.area.size
        along_x, along_y = (
            np.abs(np.diff(self.heights.astype(np.float64), axis=axis)).max(initial=0)
            for axis in (1, 0)
        )
        return float(along_x * (columns / width)), float(along_y * (rows / depth))

    def at(self, x: np.ndarray, y: np.ndarray, last: np.ndarray | None = None) -> np.ndarray:
        """Return world z (n,) float64 of the ground at world positions x, y (n,).

        last: where each agent stood before; it has no meaning on one floor.
        """
        z = np.empty(len(x))
        for begin in range(0, len(x), LOOK_UPS):
            block = slice(begin, begin + LOOK_UPS)
            (a, b, c, d), u, v, _ = self._corners(x[block], y[block])
            z[block] = (
                self.area.z + a * (1 - u) * (1 - v) + b * u * (1 - v) + c * (1 - u) * v + d * u * v
            )
        return z

    def slope(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (dz/dx, dz/dy), each (n,) float64, of the ground at x, y (n,).

        At the middle of a pixel, where four bilinear patches meet, the patch toward +x and +y
        counts. The slope is 0 where the ground continues level.
        """
        (a, b, c, d), u, v, inside = self._corners(x, y)
        rows, columns = self.heights.shape
        width, depth = self.area.size
        along_x = ((b - a) * (1 - v) + (d - c) * v) * (columns / width)
        along_y = ((c - a) * (1 - u) + (d - b) * u) * (rows / depth)
        return along_x * inside[0], along_y * inside[1]

    def tilt(
        self, x: np.ndarray, y: np.ndarray, heading: np.ndarray, last: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (pitch, roll) of agents that stand at right angles to the ground: see `lean`.

        x, y, heading: (n,); last: as in `at`.
        """
        return lean(*self.slope(x, y), heading)

    def _corners(
        self, x: np.ndarray, y: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return the heights about each position, its place between them, and if inside.

        Heights are those at the four pixel middles about it; inside: whether it lies between
        middles, along x and y.
        """
        rows, columns = self.heights.shape
        width, depth = self.area.size
        across, up = (
            (x - self.area.x_min) * (columns / width) - 0.5,
            (y - self.area.y_min) * (rows / depth) - 0.5,
        )
        inside = (across >= 0) & (across < columns - 1), (up >= 0) & (up < rows - 1)
        # at NaN anywhere
        across, up = np.fmin(np.fmax(across, 0), columns - 1), np.fmin(np.fmax(up, 0), rows - 1)
        column, row = across.astype(np.intp), up.astype(np.intp)
        right, above = np.minimum(column + 1, columns - 1), np.minimum(row + 1, rows - 1)
        places = ((row, column), (row, right), (above, column), (above, right))
        return (
            [self.heights[place].astype(np.float64) for place in places],
            across - column,
            up - row,
            inside,
        )


def lean(
    along_x: np.ndarray, along_y: np.ndarray, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (pitch, roll) of agents that stand at right angles to ground of these slopes, each
    (n,).

    Each is (n,) float32, radians. pitch: how far the ground rises ahead. roll: how far it rises
    to the agent's left.
    To tilt an agent, rotate it about z by its heading, then about its own left axis by -pitch,
    then about its own forward axis by roll.
    """
    cos, sin = np.cos(heading, dtype=np.float64), np.sin(heading, dtype=np.float64)
    ahead, left = along_x * cos + along_y * sin, along_y * cos - along_x * sin
    pitch = np.arctan(ahead)
    return pitch.astype(np.float32), np.arctan(left * np.cos(pitch)).astype(np.float32)
