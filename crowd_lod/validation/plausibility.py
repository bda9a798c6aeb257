"""Whether a crowd is plausible: sizes, speeds and heights, judged by arrays alone.

In: arrays in meters and seconds. Out: findings; None where all is as with people. A finding is a
note with a remedy, never an error: a crowd may be of giants or of ghosts.
"""

from dataclasses import dataclass

import numpy as np

HEIGHTS = 0.2, 4.0  # meters, of characters
STILL = 0.02  # m/s; an agent that is slower does not walk
SLOW = 0.1  # m/s; nobody walks so slowly
RUNS = 4.0  # m/s; people in a crowd do not walk faster
HASTE = 2.2  # m/s; a recorded crowd whose median is faster has another frame rate or unit
CLIMBS = 0.8  # meters for each meter of the way; a crowd that climbs more has another axis up
# meters: the crowd stays within the first in y while its heights spread over the second
FLAT = 0.05, 1.0
OFF = 0.1  # meters above or below the ground from which people float or sink
FEW = 0.05  # of the agents: so many may be off the ground, on a step or a curb
POSE = 0.1  # seconds for which a pose may stand


@dataclass(frozen=True)
class Finding:
    """Something about groups or agents that is unlike people.

    kind: what it is.
    indices: (k,) intp, the groups or agents that are so.
    value: what is typical of them, in meters, seconds or m/s.
    share: of all groups or agents, 0 to 1.
    """

    kind: str
    indices: np.ndarray
    value: float
    share: float


def _finding(kind: str, mask: np.ndarray, values: np.ndarray, of: int) -> Finding | None:
    (indices,) = np.nonzero(mask)
    if not len(indices):
        return None
    return Finding(kind, indices, float(np.median(values[indices])), len(indices) / of)


def check_heights(heights: np.ndarray) -> Finding | None:
    """Find groups of characters that are taller or smaller than people and animals are.

    heights: (G,); 0 for one that was not measured.
    """
    low, high = HEIGHTS
    return _finding(
        "height", (heights > 0) & ((heights < low) | (heights > high)), heights, len(heights)
    )


def check_speeds(speeds: np.ndarray, most: float) -> Finding | None:
    """Find that those who walk are too fast or too slow, or that nobody moves.

    speeds: (n,) m/s of each agent while it walks, 0 for one that never does.
    most: m/s; the median may be no faster.
    """
    walks = speeds > STILL
    if len(speeds) and not walks.any():
        return _finding("nobody moves", ~walks, speeds, len(speeds))
    median = float(np.median(speeds[walks])) if walks.any() else 0.0
    if SLOW <= median <= most or not walks.any():
        return None
    return _finding("fast" if median > most else "slow", walks, speeds, len(speeds))


def check_climbs(
    ways: np.ndarray, rises: np.ndarray, sides: np.ndarray, heights: np.ndarray
) -> Finding | None:
    """Find that z rises as the ground's second axis would: another axis is up.

    ways, rises: (k,) meters of each step, in the plane and along z.
    sides, heights: y and z of the places, meters. Where the axes are exchanged, y hardly varies.
    """
    way = float(ways.sum())
    rise = float(np.abs(rises).sum())
    is_flat = np.ptp(sides) < FLAT[0] and np.ptp(heights) > FLAT[1]
    if rise <= CLIMBS * way and not is_flat:
        return None
    return Finding("climbs", np.flatnonzero(rises), float(np.ptp(heights)), 1.0)


def check_ground(above: np.ndarray) -> list[Finding]:
    """Find agents that float above the ground, and agents that are sunk in it.

    above: (n,) of each agent's feet over the ground; NaN where there is none.
    """
    (over_ground,) = np.nonzero(~np.isnan(above))
    off = above[over_ground]
    kinds = {"floats": off > OFF, "sinks": off < -OFF}
    findings = [
        _finding(kind, chosen, np.abs(off), len(over_ground)) for kind, chosen in kinds.items()
    ]
    return [
        Finding(finding.kind, over_ground[finding.indices], finding.value, finding.share)
        for finding in findings
        if finding is not None and finding.share > FEW
    ]


def check_poses(seconds: np.ndarray) -> Finding | None:
    """Find groups whose poses are held so long that the eye notices.

    seconds: (G,) for which a pose stands; 0 for a group that moves in each frame.
    """
    return _finding("pose", seconds > POSE, seconds, len(seconds))


def median_speeds(
    agents: np.ndarray, ways: np.ndarray, seconds: np.ndarray, count: int
) -> np.ndarray:
    """Return the mean speed of each agent while it walks, (count,) m/s; 0 for one that never does.

    agents, ways, seconds: (k,), of each step the agent, its meters in the plane, and its time.
    """
    walks = ways > STILL * seconds
    way, time = (np.bincount(agents[walks], values[walks], count) for values in (ways, seconds))
    return np.divide(way, time, out=np.zeros(count), where=time > 0)
