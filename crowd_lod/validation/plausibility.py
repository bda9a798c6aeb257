"""Whether a crowd is plausible: sizes, speeds and heights, judged by arrays alone.

In: arrays in meters and seconds. Out: what is unlike people. That is a note with a remedy, never an
error: a crowd may be of giants or of ghosts.
"""

from dataclasses import dataclass

import numpy as np

HEIGHTS = 0.2, 4.0  # meters, of characters
STILL = 0.02  # m/s; an agent that is slower does not walk
SLOW = 0.1  # m/s; nobody walks so slowly
RUNS = 4.0  # m/s; people in a crowd do not walk faster
HASTE = 2.2  # m/s; a recorded crowd whose median is faster has another frame rate or unit
CLIMBS = 0.8  # meters for each meter of the way; a crowd that climbs more has another axis up
# meters: the crowd stays within the first in y while its heights spread over the second in a strip
FLAT = 0.05, 1.0
STRIP = 1.0  # meters along x
OFF = 0.1  # meters above or below the ground from which people float or sink
FEW = 0.05  # of the agents: so many may be off the ground, on a step or a curb
POSE = 0.1  # seconds for which a pose may stand


@dataclass(frozen=True)
class OffGround:
    """Agents that float above the ground, or are sunk in it.

    indices: (k,) intp, the agents.
    height: meters, the median of their feet over the ground; below 0 where they are sunk.
    share: of the agents that have a ground, 0 to 1.
    """

    indices: np.ndarray
    height: float
    share: float


def check_heights(heights: np.ndarray) -> np.ndarray:
    """Find groups of characters that are taller or smaller than people and animals are.

    heights: (G,); 0 for one that was not measured.

    Returns their indices.
    """
    low, high = HEIGHTS
    return np.flatnonzero((heights > 0) & ((heights < low) | (heights > high)))


def check_speeds(speeds: np.ndarray, most: float) -> float | None:
    """Return the median speed of those who walk if it is too fast or too slow, m/s.

    0 if nobody moves; None if all is well.

    speeds: (n,) m/s of each agent while it walks, 0 for one that never does.
    most: m/s; the median may be no faster.
    """
    if not len(speeds):
        return None
    walking = speeds[speeds > STILL]
    median = float(np.median(walking)) if len(walking) else 0.0
    return None if SLOW <= median <= most else median


def check_climbs(ways: np.ndarray, rises: np.ndarray, places: np.ndarray) -> bool:
    """Return whether z rises as the ground's second axis would: another axis is up.

    Where axes are exchanged, y hardly varies, and agents pass the same x at many z. A ramp has one
    height at each x.

    ways, rises: (k,) meters of each step, in the plane and along z.
    places: (3, n) meters.
    """
    x, y, z = places
    strips, strip = np.unique(np.floor(x / STRIP), return_inverse=True)
    lowest = np.full(len(strips), np.inf)
    highest = -lowest
    np.minimum.at(lowest, strip, z)
    np.maximum.at(highest, strip, z)
    is_flat = np.ptp(y) < FLAT[0] and (highest - lowest).max() > FLAT[1]
    return bool(is_flat or np.abs(rises).sum() > CLIMBS * ways.sum())


def check_ground(above: np.ndarray) -> list[OffGround]:
    """Find agents that float above the ground, and agents that are sunk in it.

    above: (n,) of each agent's feet over the ground; NaN where there is none.
    """
    count = np.count_nonzero(~np.isnan(above))
    found = [np.flatnonzero(off) for off in (above > OFF, above < -OFF)]
    return [
        OffGround(indices, float(np.median(above[indices])), len(indices) / count)
        for indices in found
        if len(indices) > FEW * count
    ]


def check_poses(seconds: np.ndarray) -> np.ndarray:
    """Find groups whose poses are held so long that the eye notices.

    seconds: (G,) for which a pose stands; 0 for a group that moves in each frame.

    Returns their indices.
    """
    return np.flatnonzero(seconds > POSE)


def median_speeds(
    agents: np.ndarray, ways: np.ndarray, seconds: np.ndarray, count: int
) -> np.ndarray:
    """Return the mean speed of each agent while it walks, (count,) m/s; 0 for one that never does.

    agents, ways, seconds: (k,), of each step the agent, its meters in the plane, and its time.
    """
    walks = ways > STILL * seconds
    way, time = (np.bincount(agents[walks], values[walks], count) for values in (ways, seconds))
    return np.divide(way, time, out=np.zeros(count), where=time > 0)
