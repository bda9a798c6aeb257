"""What a simulation's positions tell: where people face, and how near they come to each other."""

import numpy as np

MEMORY = 0.25  # seconds, over which a velocity is smoothed
FASTEST_TURN = np.pi  # radians a second
STANDS = 0.1  # m/s, below which people keep their heading


class Facing:
    """Where people face: along their motion, which is smoothed, and turning no faster than people.

    heading: (n,) float64 radians, as they stand at first.
    """

    def __init__(self, heading: np.ndarray):
        self.heading = heading
        self._velocity = np.zeros((len(heading), 2))

    def follow(self, people: np.ndarray, way: np.ndarray, seconds: float) -> None:
        """Turn `people` (m,), indices, who have walked the `way` (m, 2) meters in `seconds`."""
        share = 1 - np.exp(-seconds / MEMORY)
        velocity = self._velocity[people]
        velocity += share * (way / seconds - velocity)
        self._velocity[people] = velocity
        ahead = np.arctan2(velocity[:, 1], velocity[:, 0])
        before = self.heading[people]
        turn = (ahead - before + np.pi) % (2 * np.pi) - np.pi
        turn[np.hypot(*velocity.T) < STANDS] = 0
        most = FASTEST_TURN * seconds
        self.heading[people] = before + turn.clip(-most, most)


def nearest_distance(frames: np.ndarray, places: np.ndarray) -> float:
    """Return the least distance of two people in any frame, meters; inf if nobody is ever with
    another.

    frames: (k,) intp, of each row. places: (k, 2) meters.

    Two who are no further apart than half a strip's width lie in one strip, of those that begin at
    its edge or of those that begin at its middle.
    """
    width = 1.0
    low, high = (edge(places[:, 0], initial=0) for edge in (np.min, np.max))
    while True:
        halves = np.floor((places[:, 0] - low) / (width / 2)).astype(np.intp)
        most = halves.max(initial=0) + 2
        nearest = min(
            _nearest_in_strips(frames * most + (halves + shift) // 2, places) for shift in (0, 1)
        )
        if nearest <= width / 2 or width > 2 * (high - low):
            return nearest
        width *= 4


def _nearest_in_strips(strips: np.ndarray, places: np.ndarray) -> float:
    """Return the least distance of two of the places (k, 2) that are in one strip; inf if none is.

    In the order of y, only those that follow each other closely can be nearer than the nearest yet.
    """
    up = places[:, 1]
    order = np.argsort(strips + (up - up.min(initial=0)) / (np.ptp(up) + 1 if len(up) else 1))
    strip = strips[order]
    x, y = places[order].T
    nearest = np.inf
    first = np.arange(len(x))
    further = 0
    while len(first):
        further += 1
        first = first[: np.searchsorted(first, len(x) - further)]
        second = first + further
        is_near = (strip[second] == strip[first]) & (y[second] - y[first] < nearest)
        first = first[is_near]
        second = second[is_near]
        apart = np.hypot(x[second] - x[first], y[second] - y[first])
        nearest = min(nearest, float(apart.min(initial=np.inf)))
    return nearest
