"""How fast a crowd moves at most."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class VelocityBounds:
    """How far agents may get from where they stood, in both directions, m/s.

    low, high: (3,) float64, the bounds of the velocity along x, y and z; low <= 0 <= high.
    fastest: m/s, the greatest horizontal speed, if it is known to be less than that of the bounds.
    """

    low: np.ndarray
    high: np.ndarray
    fastest: float = np.inf

    def between(self, seconds: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return (least, most) displacement, each (3,) metres, at any time in `seconds`.

        seconds: relative to the time of the boxes.
        """
        ways = np.multiply.outer((min(seconds), max(seconds)), (self.low, self.high))
        return np.minimum(ways.min(axis=(0, 1)), 0.0), np.maximum(ways.max(axis=(0, 1)), 0.0)

    @cached_property
    def speed(self) -> float:
        """The greatest horizontal speed, m/s."""
        x, y, _ = np.maximum(-self.low, self.high).tolist()
        return min(self.fastest, float(np.hypot(x, y)))

    def joined(self, other: "VelocityBounds") -> "VelocityBounds":
        """Return the bounds of both crowds."""
        fastest = max(self.speed, other.speed)
        return VelocityBounds(np.minimum(self.low, other.low), np.maximum(self.high, other.high), fastest)


STANDING = VelocityBounds(np.zeros(3), np.zeros(3), 0.0)
