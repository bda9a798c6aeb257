"""The rows of a file of tracks as they are kept, with what holds until each agent's next row."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class TrackSamples:
    """The rows of a file, each with what holds until the agent's next row, in the order of Tracks.

    agent: (k,) int32.
    frame: (k,) float64, of the file.
    x, y, z: (k,) float64 meters; z None if the file has none.
    heading, turn: (k,) float32 radians, and its change until the next row.
    way: (k,) float32 meters walked since the agent entered, or cycles if the file gives phases.
    pace: (k,) uint8.
    walks, hidden: (k,) bool, whether the agent walks, and whether a long gap hides it.
    after: (k,) int32, the place of the agent's next row; its own at the agent's last.
    """

    agent: np.ndarray
    frame: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray | None
    heading: np.ndarray
    turn: np.ndarray
    way: np.ndarray
    pace: np.ndarray
    walks: np.ndarray
    hidden: np.ndarray
    after: np.ndarray
