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
    steps: meters by which z may change at once, as on stairs, however short the time.
    """

    low: np.ndarray
    high: np.ndarray
    fastest: float = np.inf
    steps: float = 0.0

    def between(self, seconds: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return (least, most) displacement, each (3,) meters, at any time in `seconds`.

        seconds: relative to the time of the boxes.
        """
        ways = np.multiply.outer((min(seconds), max(seconds)), (self.low, self.high))
        rise = np.array([0.0, 0.0, self.steps])
        least = np.minimum(ways.min(axis=(0, 1)), 0.0) - rise
        most = np.maximum(ways.max(axis=(0, 1)), 0.0) + rise
        return least, most

    @property
    def climbs(self) -> bool:
        """Whether z may change."""
        return bool(self.high[2] > 0 or self.low[2] < 0 or self.steps > 0)

    @cached_property
    def speed(self) -> float:
        """The greatest horizontal speed, m/s."""
        x, y, _ = np.maximum(-self.low, self.high).tolist()
        return min(self.fastest, float(np.hypot(x, y)))

    def union(self, other: "VelocityBounds") -> "VelocityBounds":
        """Return the bounds of both crowds."""
        return VelocityBounds(
            low=np.minimum(self.low, other.low),
            high=np.maximum(self.high, other.high),
            fastest=max(self.speed, other.speed),
            steps=max(self.steps, other.steps),
        )


STANDING = VelocityBounds(np.zeros(3), np.zeros(3), 0.0)
