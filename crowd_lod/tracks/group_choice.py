"""Which character group each agent of a file shows."""

from collections.abc import Sequence

import numpy as np

from ..crowd import random_streams
from .tracks import Tracks


def groups_of_agents(
    tracks: Tracks, names: Sequence[str], choices: np.ndarray, seed: int
) -> np.ndarray:
    """Return (n,) uint8, the index of each agent's character group.

    Groups that the file names as the scene does are these. Any others, and whole numbers, take the
    crowd's groups in turn. Without groups in the file they are drawn.

    names: of all character groups of the scene.
    choices: (k,) uint8, the groups that the crowd's agents are drawn from.
    seed: of the draw.
    """
    if tracks.group is None:
        keys = random_streams.keys_of(seed, tracks.ids)
        draw = random_streams.uniform(keys, random_streams.THEN)
        return choices[np.minimum((draw * len(choices)).astype(np.intp), len(choices) - 1)]
    values, value_of_agent = np.unique(tracks.group, return_inverse=True)
    if tracks.group.dtype.kind == "U":
        numbers = {name.casefold(): g for g, name in enumerate(names)}
        groups = [
            numbers.get(str(value).strip().casefold(), choices[k % len(choices)])
            for k, value in enumerate(values)
        ]
    else:
        groups = [choices[int(value) % len(choices)] for value in values]
    return np.array(groups, np.uint8)[value_of_agent]
