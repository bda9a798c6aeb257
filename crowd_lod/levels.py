"""Level of detail from distance: a sum of unit steps (chapter eq 1.7, listing 1.4)."""

from dataclasses import dataclass

import numpy as np

from .errors import CrowdError

MOST_LEVELS = 8
METRICS = ("AXIS", "RADIAL")


@dataclass(frozen=True)
class LevelPolicy:
    """How levels follow from distance.

    thresholds: n - 1 parts of the far distance, strictly increasing in (0, 1], for n LODs. metric: AXIS measures along
    the view (the chapter's v.Z), RADIAL from the camera (|v|). margin: None for the derived widening of the frustum, or
    the chapter's fixed Delta in metres.
    """

    thresholds: tuple[float, ...]
    metric: str = "AXIS"
    margin: float | None = None

    def __post_init__(self):
        if len(self.thresholds) >= MOST_LEVELS:
            raise CrowdError(f"There are {len(self.thresholds) + 1} levels of detail; use 1 to {MOST_LEVELS}.")
        if self.metric not in METRICS:
            raise CrowdError(f"The LOD metric is {self.metric!r}; use one of {', '.join(METRICS)}.")
        if self.margin is not None and not 0 <= self.margin < np.inf:
            raise CrowdError(f"The fixed margin is {self.margin} m; it must be finite and at least 0.")
        before = 0.0
        for number, threshold in enumerate(self.thresholds):
            if not before < threshold <= 1:
                raise CrowdError(
                    f"LOD threshold {number} is {threshold:g}; thresholds must increase strictly within (0, 1], and the "
                    f"one before is {before:g}."
                )
            before = threshold

    @property
    def count(self) -> int:
        """The number of LODs."""
        return len(self.thresholds) + 1


def assign(distance: np.ndarray, far: float, thresholds: tuple[float, ...]) -> np.ndarray:
    """LOD ids (n,) uint8, 0 the finest: the sum of U(distance - far tau_i) with U(0) = 1.

    distance: (n,) float64 metres; far: metres.
    """
    ids = np.zeros(len(distance), np.uint8)
    for threshold in thresholds:
        ids += distance >= far * threshold
    return ids
