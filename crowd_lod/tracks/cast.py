"""Which character group each agent of a file shows."""

from collections.abc import Sequence

import numpy as np

from ..crowd import random_streams
from .tracks import Tracks


def groups_of_agents(
    tracks: Tracks, names: Sequence[str], own: np.ndarray, seed: int
) -> np.ndarray:
    """Return (n,) uint8, the index of each agent's character group.

    Groups that the file names as the scene does are these. Any others, and whole numbers, take the
    crowd's groups in turn. Without groups in the file they are drawn.

    names: of all character groups of the scene.
    own: (k,) uint8, the groups that the crowd's agents are drawn from.
    seed: of the draw.
    """
    if tracks.group is None:
        drawn = random_streams.uniform(
            random_streams.keys_of(seed, tracks.ids), random_streams.THEN
        )
        return own[np.minimum((drawn * len(own)).astype(np.intp), len(own) - 1)]
    told, which = np.unique(tracks.group, return_inverse=True)
    known = {name.casefold(): g for g, name in enumerate(names)}
    if tracks.group.dtype.kind == "U":
        found = [
            known.get(str(each).strip().casefold(), own[k % len(own)])
            for k, each in enumerate(told)
        ]
    else:
        found = [own[int(each) % len(own)] for each in told]
    return np.array(found, np.uint8)[which]
