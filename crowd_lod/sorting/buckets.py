"""LOD sorting: one contiguous bucket of agents per LOD (chapter section 1.4)."""

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from ..culling.blocks import CULLED, OPEN, Blocks


@dataclass(frozen=True)
class Buckets:
    """Visible agents by LOD.

    order: (m,) int32, agent indices, finest LOD first. Within a LOD they are in agent order; in a
        large crowd in the order of its blocks (culling/blocks.py).
    offsets: (n + 1,) intp. LOD k is order[offsets[k]:offsets[k + 1]].
    """

    order: np.ndarray
    offsets: np.ndarray

    def __getitem__(self, level: int) -> np.ndarray:
        return self.order[self.offsets[level] : self.offsets[level + 1]]

    @property
    def levels(self) -> np.ndarray:
        """The LOD of each in `order`, (m,) uint8."""
        return np.repeat(np.arange(len(self.offsets) - 1, dtype=np.uint8), self.counts)

    def among(self, agents: np.ndarray) -> "Buckets":
        """Return the buckets of those that are among `agents`, (n,) bool."""
        is_among = agents[self.order]
        offsets = np.append(0, np.cumsum(is_among))[self.offsets]
        return Buckets(self.order[is_among], offsets)

    @property
    def counts(self) -> np.ndarray:
        """Agents in each LOD, (n,) intp."""
        return np.diff(self.offsets)


def sort(visible: np.ndarray, ids: np.ndarray, count: int) -> Buckets:
    """Return the buckets of the visible agents.

    One pass: NumPy's stable sort of uint8 is a radix sort, the counting sort of the chapter's
    future work.
    visible: (n,) bool.
    ids: (n,) uint8, LOD ids below `count`.
    """
    agents = np.flatnonzero(visible).astype(np.int32)
    levels = ids[agents]
    offsets = np.zeros(count + 1, np.intp)
    np.cumsum(np.bincount(levels, minlength=count), out=offsets[1:])
    return Buckets(agents[np.argsort(levels, kind="stable")], offsets)


def sort_blocks(blocks: Blocks, decided: np.ndarray, levels: np.ndarray, count: int) -> Buckets:
    """Return the buckets of the agents in blocks, in the order of these.

    decided: (b,) uint8, the LODs of the blocks; OPEN where agents have their own.
    levels: (m,) uint8, the LODs of the agents in OPEN blocks; `count` or above for culled agents.
    """
    is_open = decided == OPEN
    size = blocks.rows.shape[1]
    own = np.full((np.count_nonzero(is_open), size), CULLED, np.uint8)
    own.reshape(-1)[: len(levels)] = levels
    buckets = []
    for level in range(count):
        numbers = ((decided == level) | is_open).nonzero()[0]
        has_level = np.ones((len(numbers), size), bool)
        has_level[is_open.take(numbers)] = own == level
        buckets.append(blocks.rows.take(numbers, axis=0)[has_level])
    return Buckets(np.concatenate(buckets), np.cumsum([0, *map(len, buckets)]))


def count_groups(group: np.ndarray, agents: np.ndarray, groups: int) -> np.ndarray:
    """Return how many of `agents` (m,), ordered group by group, each group has, (groups,).

    group: (n,) uint8, of all agents; only a few entries are read.
    """
    if groups == 1:
        return np.array([len(agents)])
    begins = (bisect_left(agents, g, key=group.__getitem__) for g in range(groups))
    return np.diff([*begins, len(agents)])
