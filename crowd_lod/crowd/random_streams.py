"""Random numbers that depend only on the agent and on its own events.

Each agent carries a key. An event (the agent enters a state, or a label) advances the key by one
step. A draw hashes the key and does not change it. So an agent's k-th draw is the same for every
step length, every order of frames, and every other crowd around it.
The hash is SplitMix64 (Steele, Lea, Flood 2014), one stream per agent.
"""

import hashlib

import numpy as np

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
# Streams of draws from one key, far apart: what follows on a label, what follows a timer, and how
# long the timer runs.
STATE = np.uint64(0)
THEN = np.uint64(0x14057B7EF767814F)
TIME = np.uint64(0x5851F42D4C957F2D)
# From an agent's first key: its looks, its size.
LOOKS = np.uint64(0x2545F4914F6CDD1D)
SIZE = np.uint64(0xD1342543DE82EF95)


def keys(seed: int, count: int) -> np.ndarray:
    """Return the first keys (count,) uint64 of agents 0 to count - 1."""
    return keys_of(seed, np.arange(count, dtype=np.uint64))


def keys_of(seed: int, ids: np.ndarray) -> np.ndarray:
    """Return the first keys (n,) uint64 of the agents `ids`, (n,) whole numbers."""
    start = _mixed(np.array([seed % 2**64], np.uint64))
    return _mixed(start ^ ids.astype(np.uint64))


def advance_keys(key: np.ndarray, events: np.ndarray) -> np.ndarray:
    """Return the keys (n,) uint64 after `events` (n,), 0 or 1 each."""
    return key + _GAMMA * events.astype(np.uint64)


def uniform(key: np.ndarray, stream: np.uint64) -> np.ndarray:
    """Return (n,) float64 in [0, 1), of 53 bits, one for each key (n,) uint64.

    stream: which draw of the key: STATE, THEN, TIME, LOOKS, SIZE, or a `named` one.
    """
    return (_mixed(key ^ stream) >> np.uint64(11)) * 2.0**-53


def named(name: str) -> np.uint64:
    """Return the stream of draws that has this name."""
    return np.uint64(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little"))


def _mixed(z: np.ndarray) -> np.ndarray:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
