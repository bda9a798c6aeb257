"""Where a shot's values lie: one cell for an agent in a frame, of the frames that show it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..progress import check_cancelled

TOGETHER = 8192  # agents of a block: their rows stay in the processor's cache


@dataclass(frozen=True)
class Block:
    """Agents that are in the picture in the same part of the shot.

    agents: (m,) intp.
    begin, end: the first frame that has cells of them, and the one after the last.
    first: the cell of the first agent in the first frame. Frame follows frame, m cells each.
    """

    agents: np.ndarray
    begin: int
    end: int
    first: int

    @property
    def count(self) -> int:
        """The number of cells."""
        return (self.end - self.begin) * len(self.agents)

    def table(self, values: np.ndarray) -> np.ndarray:
        """Return the part of `values` (N,) that is of this block: a view, (end - begin, m)."""
        return values[self.first : self.first + self.count].reshape(-1, len(self.agents))


@dataclass(frozen=True)
class Cells:
    """The N cells of n agents: blocks of agents that come and go together.

    first, last: (n,) of whole numbers, the first frame of each agent, and the one after its last;
        the same for agents without cells.
    together: agents of a block at most.
    """

    first: np.ndarray
    last: np.ndarray
    together: int = TOGETHER

    @cached_property
    def blocks(self) -> list[Block]:
        """All agents that have cells, in the order of their first and last frames."""
        order = np.lexsort((self.last, self.first))
        order = order[self.first[order] < self.last[order]]
        blocks = []
        count = 0
        for begin in range(0, len(order), self.together):
            agents = order[begin : begin + self.together]
            span = int(self.first[agents].min()), int(self.last[agents].max())
            blocks.append(Block(agents, *span, count))
            count += blocks[-1].count
        return blocks

    @property
    def count(self) -> int:
        """N."""
        return sum(block.count for block in self.blocks)

    @cached_property
    def _strides(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) intp: the cell that each agent would have in frame 0, and the step to the next."""
        origin = np.zeros(len(self.first), np.intp)
        step = np.zeros(len(self.first), np.intp)
        for block in self.blocks:
            step[block.agents] = len(block.agents)
            begin = block.first - block.begin * len(block.agents)
            origin[block.agents] = begin + np.arange(len(block.agents))
        return origin, step

    def at(self, f: int | np.ndarray, agents: np.ndarray) -> np.ndarray:
        """Return the cells (m,) of `agents` in frame `f`, which must be one of theirs."""
        origin, step = self._strides
        return origin[agents] + f * step[agents]

    def holds(self, f: int | np.ndarray, agents: np.ndarray) -> np.ndarray:
        """Return which of `agents` (m,) have a cell of their own in frame `f`, (m,) bool."""
        return (self.first[agents] <= f) & (f < self.last[agents])

    def in_frame(self, f: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (agents, their cells) of a frame, both (m,) intp, in the order of the agents."""
        blocks = [block for block in self.blocks if block.begin <= f < block.end]
        agents = np.sort(np.concatenate([np.empty(0, np.intp), *(b.agents for b in blocks)]))
        return agents, self.at(f, agents)

    def row(self, values: np.ndarray, f: int) -> np.ndarray:
        """Return `values` (N,) in frame `f` for all agents, (n,).

        Before its first cell an agent has the value of that one; without cells, and after the
        last, 0.
        """
        row = np.zeros(len(self.first), values.dtype)
        for block in self.blocks:
            if f < block.end:
                row[block.agents] = block.table(values)[max(f - block.begin, 0)]
        return row

    def of(self, agents: np.ndarray) -> "Cells":
        """Return the cells of these agents (m,) alone, numbered from 0 on."""
        return Cells(self.first[agents], self.last[agents], self.together)

    def extract(self, values: np.ndarray, agents: np.ndarray) -> np.ndarray:
        """Return `values` (N,) in the cells of `of(agents)`, and 0 where these have none here."""
        cells = self.of(agents)
        part = np.zeros(cells.count, values.dtype)
        for block in cells.blocks:
            numbers = agents[block.agents]
            frame = np.arange(block.begin, block.end)[:, None]
            is_here = self.holds(frame, numbers)
            block.table(part)[is_here] = values[self.at(frame, numbers)[is_here]]
        return part

    def tables(self, *values: np.ndarray) -> Iterator[tuple]:
        """Yield (a block, its table of each of `values` (N,)), block after block.

        It is a place where work that nobody waits for ends.
        """
        for block in self.blocks:
            check_cancelled()
            yield (block, *(block.table(column) for column in values))
