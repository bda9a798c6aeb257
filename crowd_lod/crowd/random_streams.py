"""Random numbers that depend on the agent and on what has happened to it, and on nothing else.

Each agent carries a key. An event (it enters a state, or a label) moves the key on by one; a draw hashes the key and
leaves it alone. So the k-th draw of an agent is the same whatever the length of the step, whichever frame was asked
for before, and whoever else is in the crowd. This is SplitMix64 (Steele, Lea, Flood 2014), one stream an agent.
"""

import numpy as np

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
# Streams of draws from one key, far apart: what follows on a label, what follows a timer, how long the timer runs, and
# from an agent's first key its looks.
STATE, THEN, TIME = np.uint64(0), np.uint64(0x14057B7EF767814F), np.uint64(0x5851F42D4C957F2D)
LOOKS = np.uint64(0x2545F4914F6CDD1D)


def keys(seed: int, count: int) -> np.ndarray:
    """The first keys (count,) uint64 of agents 0 … count - 1."""
    start = _mixed(np.array([seed % 2**64], np.uint64))
    return _mixed(start ^ np.arange(count, dtype=np.uint64))


def moved_on(key: np.ndarray, events: np.ndarray) -> np.ndarray:
    """The keys (n,) uint64 after `events` (n,), 0 or 1 each."""
    return key + _GAMMA * events.astype(np.uint64)


def uniform(key: np.ndarray, stream: np.uint64) -> np.ndarray:
    """(n,) float64 in [0, 1), of 53 bits, one for each key (n,) uint64."""
    return (_mixed(key ^ stream) >> np.uint64(11)) * 2.0**-53


def _mixed(z: np.ndarray) -> np.ndarray:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
