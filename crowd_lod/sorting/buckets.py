"""LOD sorting: one contiguous bucket of agents a LOD (chapter section 1.4)."""

from dataclasses import dataclass

import numpy as np

from ..culling.blocks import LEAF, OPEN, Blocks, Decided, edges


@dataclass(frozen=True)
class Buckets:
    """Visible agents by LOD. order: (m,) int32, agent indices, finest LOD first; within a LOD in agent order, in a large
    crowd in that of its blocks (culling/blocks.py). offsets: (n + 1,) intp: LOD k is order[offsets[k]:offsets[k + 1]]."""

    order: np.ndarray
    offsets: np.ndarray

    def __getitem__(self, level: int) -> np.ndarray:
        return self.order[self.offsets[level] : self.offsets[level + 1]]

    @property
    def levels(self) -> np.ndarray:
        """The LOD of each in `order`, (m,) uint8."""
        return np.repeat(np.arange(len(self.offsets) - 1, dtype=np.uint8), self.counts)

    @property
    def counts(self) -> np.ndarray:
        """Agents in each LOD, (n,) intp."""
        return np.diff(self.offsets)


def sort(visible: np.ndarray, ids: np.ndarray, count: int, lean: bool = False) -> Buckets:
    """Buckets of the visible agents. visible: (n,) bool; ids: (n,) uint8 LOD ids below `count`.

    One pass: NumPy's stable sort of uint8 is a radix sort, the counting sort of the chapter's future work. lean: agents
    that all have one LOD are in order as they are.
    """
    agents = np.flatnonzero(visible).astype(np.int32)
    seen = ids[agents]
    counts, offsets = np.bincount(seen, minlength=count), np.zeros(count + 1, np.intp)
    np.cumsum(counts, out=offsets[1:])
    if lean and counts.max() == len(seen):
        return Buckets(agents, offsets)
    return Buckets(agents[np.argsort(seen, kind="stable")], offsets)


def sort_in_order(levels: np.ndarray, order: np.ndarray, count: int) -> Buckets:
    """Buckets of agents that come in another order than theirs. order: (n,) int32 agent indices; levels: (n,) uint8, the
    LOD ids of these, at `count` or above for those culled."""
    buckets = [order[levels == level] for level in range(count)]
    return Buckets(np.concatenate(buckets), np.cumsum([0, *map(len, buckets)]))


def sort_blocks(blocks: Blocks, decided: Decided, group: np.ndarray, count: int) -> tuple[Buckets, np.ndarray]:
    """(the buckets of agents in blocks, how many agents of each LOD and group (count, G)): blocks of one LOD go as they are. group:
    (n,) uint8, of all agents."""
    buckets, groups = [], len(blocks.groups) - 1
    differ = decided.leaves == OPEN
    for level in range(count):
        leaves = ((decided.leaves == level) | differ).nonzero()[0]
        shown = np.ones((len(leaves), LEAF), bool)
        shown[differ.take(leaves).nonzero()[0]] = decided.own == level
        buckets.append(blocks.rows.take(leaves, axis=0)[shown])
    present = [np.diff(edges(group, agents, groups)) if groups > 1 else [len(agents)] for agents in buckets]
    return Buckets(np.concatenate(buckets), np.cumsum([0, *map(len, buckets)])), np.array(present)
