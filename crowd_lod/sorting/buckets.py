"""LOD sorting: one contiguous bucket of agents per LOD (chapter section 1.4)."""

from dataclasses import dataclass

import numpy as np

from ..culling.blocks import LEAF, OPEN, BlockDecisions, Blocks, edges


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


def sort_in_order(levels: np.ndarray, order: np.ndarray, count: int) -> Buckets:
    """Return the buckets of agents that are not in agent order.

    order: (n,) int32, agent indices.
    levels: (n,) uint8, their LOD ids; `count` or above for culled agents.
    """
    buckets = [order[levels == level] for level in range(count)]
    return Buckets(np.concatenate(buckets), np.cumsum([0, *map(len, buckets)]))


def sort_blocks(
    blocks: Blocks, decided: BlockDecisions, group: np.ndarray, count: int
) -> tuple[Buckets, np.ndarray]:
    """Return (buckets of the agents in blocks, their counts (count, G)).

    The counts are by LOD and group. A block whose agents all have one LOD is taken whole.
    group: (n,) uint8, of all agents.
    """
    buckets = []
    groups = len(blocks.groups) - 1
    differ = decided.leaves == OPEN
    for level in range(count):
        leaves = ((decided.leaves == level) | differ).nonzero()[0]
        has_level = np.ones((len(leaves), LEAF), bool)
        has_level[differ.take(leaves).nonzero()[0]] = decided.open_levels == level
        buckets.append(blocks.rows.take(leaves, axis=0)[has_level])
    present = [
        np.diff(edges(group, agents, groups)) if groups > 1 else [len(agents)] for agents in buckets
    ]
    return Buckets(np.concatenate(buckets), np.cumsum([0, *map(len, buckets)])), np.array(present)
