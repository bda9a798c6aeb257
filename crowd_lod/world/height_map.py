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
                f"column {column}, row {row} from the bottom: paint a height there."
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
        heights = self.heights.astype(np.float64)
        rise_x = np.abs(np.diff(heights, axis=1)).max(initial=0)
        rise_y = np.abs(np.diff(heights, axis=0)).max(initial=0)
        return float(rise_x * (columns / width)), float(rise_y * (rows / depth))

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
        """Return (heights, u, v, inside) of positions x, y (n,).

        heights: those at the four pixel middles about each: lower left, lower right, upper left,
            upper right.
        u, v: the place between them, 0 to 1 along x and y.
        inside: whether it lies between middles, along x and along y.
        """
        rows, columns = self.heights.shape
        width, depth = self.area.size
        u = (x - self.area.x_min) * (columns / width) - 0.5
        v = (y - self.area.y_min) * (rows / depth) - 0.5
        inside = (u >= 0) & (u < columns - 1), (v >= 0) & (v < rows - 1)
        # at NaN anywhere
        u = np.fmin(np.fmax(u, 0), columns - 1)
        v = np.fmin(np.fmax(v, 0), rows - 1)
        left = u.astype(np.intp)
        below = v.astype(np.intp)
        right = np.minimum(left + 1, columns - 1)
        above = np.minimum(below + 1, rows - 1)
        pixels = ((below, left), (below, right), (above, left), (above, right))
        heights = [self.heights[pixel].astype(np.float64) for pixel in pixels]
        return heights, u - left, v - below, inside


def lean(
    along_x: np.ndarray, along_y: np.ndarray, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (pitch, roll) of agents that stand at right angles to the ground.

    along_x, along_y: (n,) slopes of the ground, rises over runs.

    pitch: (n,) float32 radians, how far the ground rises ahead.
    roll: likewise, how far it rises to the agent's left.

    To tilt an agent, rotate it about z by its heading, then about its own left axis by -pitch,
    then about its own forward axis by roll.
    """
    cos = np.cos(heading, dtype=np.float64)
    sin = np.sin(heading, dtype=np.float64)
    ahead = along_x * cos + along_y * sin
    left = along_y * cos - along_x * sin
    pitch = np.arctan(ahead)
    roll = np.arctan(left * np.cos(pitch))
    return pitch.astype(np.float32), roll.astype(np.float32)
