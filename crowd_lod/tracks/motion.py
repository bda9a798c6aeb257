"""What a track tells of an agent's motion: its speed, where it faces, how far it has come.

Rows are in the order of agents, and of each agent in the order of frames. A run is a stretch of an
agent's rows, without a gap that hides it.
"""

import numpy as np

from ..crowd import random_streams

SMOOTHED = 0.5  # seconds, over which a motion is smoothed
STANDS = 0.1  # m/s, below which an agent stands
PACES = 6  # at most, the one of standing among them
APART = 1.08  # ratio of a pace to the one before, at least
SAMPLE = 1_000_000  # speeds from which the paces are made, at most


def last_of(begins: np.ndarray) -> np.ndarray:
    """Return (k,) intp: for each row the last row of its run.

    begins: (k,) bool, whether a run begins there.
    """
    first = np.flatnonzero(begins)
    return np.repeat(np.append(first[1:], len(begins)) - 1, np.diff(np.append(first, len(begins))))


def first_of(begins: np.ndarray) -> np.ndarray:
    """Return (k,) intp: for each row the first row of its run."""
    first = np.flatnonzero(begins)
    return np.repeat(first, np.diff(np.append(first, len(begins))))


def velocities(
    x: np.ndarray, y: np.ndarray, seconds: np.ndarray, begins: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed velocities, m/s along x and along y, each (k,) float32.

    A row's is that of the straight way between the rows a quarter of a second before and after it,
    or the next rows of its run; 0 where it has none.

    seconds: (k,) float64, of the rows.
    step: seconds from one row to the next, as most are.
    """
    near = max(round(SMOOTHED / 2 / step), 1) if step > 0 else 1
    rows = np.arange(len(x))
    first = first_of(begins)
    last = last_of(begins)
    # rows at the edges of runs, and those before and after them in their run
    edge = np.flatnonzero((rows - near < first) | (rows + near > last))
    before = np.maximum(edge - near, first[edge])
    after = np.minimum(edge + near, last[edge])

    def change(values: np.ndarray) -> np.ndarray:
        difference = np.empty(len(values))
        difference[near : len(values) - near] = values[2 * near :] - values[: -2 * near]
        difference[edge] = values[after] - values[before]
        return difference

    passed = change(seconds)
    passed[passed == 0] = np.inf
    vx = (change(x) / passed).astype(np.float32)
    vy = (change(y) / passed).astype(np.float32)
    return vx, vy


def headings(
    vx: np.ndarray, vy: np.ndarray, moving: np.ndarray, agent: np.ndarray, ids: np.ndarray
) -> np.ndarray:
    """Return where agents face, (k,) float32 radians: along their motion.

    An agent that stands faces as when it walked last; before it walks, where it will walk. One that
    never walks faces anywhere.
    """
    rows = np.arange(len(vx))
    walked = np.maximum.accumulate(np.where(moving, rows, -1))
    first = np.flatnonzero(np.diff(agent, prepend=-1))
    strange = walked < first[agent]  # another agent's row, or none
    if strange.any():
        coming = np.minimum.accumulate(np.where(moving, rows, len(rows))[::-1])[::-1]
        walked = np.where(strange, coming, walked)
        is_own = walked < np.append(first, len(rows))[agent + 1]
        walked = np.where(is_own, walked, first[agent])
    heading = np.arctan2(vy, vx)
    still = np.flatnonzero(np.add.reduceat(moving, first, dtype=np.intp) == 0)
    keys = random_streams.keys_of(0, ids[still])
    heading[first[still]] = random_streams.uniform(keys, random_streams.LOOKS) * 2 * np.pi - np.pi
    return heading[walked]


def turns(values: np.ndarray, round_about: float) -> np.ndarray:
    """Return by how much `values` change to the next row, the shorter way about a circle, (k,).

    0 at the last row.
    """
    change = np.diff(values, append=values[-1:])
    return change - round_about * np.rint(change / round_about)


def sum_by_agent(change: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Return (k,) float64: the sum of `change` over the agent's rows before each row.

    begins: where agents begin.
    """
    total = np.append(0.0, np.cumsum(change, dtype=np.float64)[:-1])
    return total - total[first_of(begins)]


def ladder(speed: np.ndarray) -> np.ndarray:
    """Return the paces at which agents play their walk, (P,) float64 m/s, increasing from 0.

    speed: (k,) m/s of rows at which agents walk.
    """
    paces = [0.0]
    if len(speed):
        sample = speed[:: -(-len(speed) // SAMPLE)].astype(np.float64)
        parts = (np.arange(PACES - 1) + 0.5) / (PACES - 1)
        for pace in np.quantile(sample, parts).round(3).tolist():
            if pace >= max(paces[-1] * APART, STANDS / 2):
                paces.append(pace)
    return np.array(paces)


def paces_of(speed: np.ndarray, begins: np.ndarray, paces: np.ndarray) -> np.ndarray:
    """Return each row's pace, (k,) uint8.

    It is the nearest at first, then another where that is nearer by a quarter of the step.

    speed: (k,) float32 m/s.
    begins: (k,) bool, where agents begin.
    """
    pace = np.zeros(len(speed), np.uint8)
    rows = np.arange(len(speed))
    for low, high in zip(paces[:-1], paces[1:], strict=True):
        middle = np.float32((low + high) / 2)
        band = np.float32((high - low) / 8)
        above = speed > middle
        sure = np.abs(speed - middle) > band
        sure |= begins
        pace += above[np.maximum.accumulate(np.where(sure, rows, 0))]
    return pace
