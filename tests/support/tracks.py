"""Small files of tracks for the tests."""

import numpy as np
from crowd_lod_extension.crowd_lod.sources.recorded import Recorded
from crowd_lod_extension.crowd_lod.tracks.rows import Rows, tracks_of

from .crowds import walker
from .shots import IDLER

GROUPS = (walker(), IDLER, walker(stride=0.7))


def wanderers(agents=300, frames=200, rate=16.0, seed=1, gaps=True, z=False):
    """Rows of agents who enter and leave, walk at speeds that change, stand now and then, and are
    lost for some frames.
    """
    random = np.random.default_rng(seed)
    parts = []
    for agent in range(agents):
        since = int(random.integers(0, frames // 2))
        frame = np.arange(since, since + int(random.integers(2, frames // 2)))
        speed = np.clip(np.cumsum(random.normal(0, 0.2, len(frame))) + random.uniform(0, 2), 0, 2.5)
        speed[speed < 0.4] = 0
        angle = np.cumsum(random.normal(0, 0.1, len(frame))) + random.uniform(-3, 3)
        x, y = (
            np.cumsum(speed / rate * of(angle)) + random.uniform(*span)
            for of, span in ((np.cos, (-40, 40)), (np.sin, (0, 90)))
        )
        height = np.cumsum(random.normal(0, 0.02, len(frame)))
        kept = np.ones(len(frame), bool)
        if gaps and agent % 3 == 0 and len(frame) > 12:
            lost = int(random.integers(1, len(frame) - 2))
            kept[lost : lost + int(random.integers(1, 60))] = False
            kept[-1] = True
        parts.append(
            np.column_stack([np.full(len(frame), 7 * agent + 3), frame, x, y, height])[kept]
        )
    found = np.concatenate(parts)
    found = found[random.permutation(len(found))]
    columns = [np.ascontiguousarray(column) for column in found.T]
    return Rows(
        columns[0].astype(np.int64), *columns[1:4], z=columns[4] if z else None, rate=rate, unit="m"
    )


def recorded(rows=None, fps=24.0, **more):
    """The trajectory of rows, with three groups."""
    tracks = tracks_of(wanderers() if rows is None else rows, "test.csv")
    group = np.random.default_rng(2).integers(0, len(GROUPS), len(tracks.ids)).astype(np.uint8)
    return Recorded(tracks, GROUPS, group, 1 / fps, **more)
