"""What the decisions on a whole shot need to know of each agent in each frame.

A shot is run through once (recording.py), and decided on from this. Its values lie in cells: one
for an agent in a frame, of the frames that show it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from ..animation.phase_classes import Roles
from ..progress import check_cancelled, map_in_threads
from .phases import Meetings

# Kinds of agents in a frame. Hidden ones are counted, and have no cells of their own.
CULLED, SEEN, SHADOW, MIRRORED = range(4)


class Cause(IntEnum):
    """Why an agent appears, or vanishes, at once: a clip of the camera, or an override's end."""

    NEAR = 0
    FAR = 1
    OVERRIDE = 2


# an agent that appears or vanishes at once, and why
AT_ONCE = np.dtype([("agent", np.intp), ("cause", np.uint8)])


def at_once(agents: np.ndarray, cause: np.ndarray | Cause) -> np.ndarray:
    """Return rows of AT_ONCE, (m,); agents: (m,) intp; cause: of Cause, one or (m,)."""
    rows = np.empty(len(agents), AT_ONCE)
    rows["agent"] = agents
    rows["cause"] = cause
    return rows


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


@dataclass(frozen=True)
class Survey:
    """F frames of n agents. What it knows of an agent in a frame lies in N cells.

    numbers: (F,) int64, the frames on the timeline.
    times: (F,) float64, the same in frames of the animation.
    cuts: (F,) bool; True where another camera films than in the frame before.
    cells: of agents that are not culled.
    kind: (N,) uint8, one of CULLED, SEEN, SHADOW (casts a shadow into the picture, or
        takes light of the sky from it, and is not seen), MIRRORED (a mirror shows it).
    coarsest: (N,) uint8, the coarsest LOD that the policy allows. For SHADOW and MIRRORED the LOD
        that they have. 0 for culled agents.
    scale: (N,) float16, pixels that one meter shows at the agent's nearest part, rounded up; no
        part counts as nearer than the camera's near clip. 0 for agents that are not seen.
    character: (N,) uint8 or uint16, which of the L characters of the cast an agent shows.
    group: (n,) uint8, the group of each agent.
    owner: (L,) uint8, the group of each character.
    rays: (F,) float64, samples of the pixels that agents cover (levels/cost_model.py).
    hidden: (F,) int64, how many agents scenery hides, and their shadows.
    entered: for each frame (m,) AT_ONCE, the agents that it shows, and that the near or the far
        clip culled in the frame before, or an override hid.
    left: for each frame (m,) AT_ONCE, the agents that the frame before shows, and that the near or
        the far clip culls.
    blurred: whether LODs of blurred agents deviate by more than the tolerance, as many pixels as
        these are blurred wide. Their `scale` counts as many pixels less in proportion.
    roles: what the characters play; None if no neighbors are to be found.
    meetings: of agents that are close neighbors.
    finest, limit: (N,) uint8, the finest and the coarsest LOD that overrides allow seen agents,
        whatever the policy does; None without overrides (shot/overrides.py).
    """

    numbers: np.ndarray
    times: np.ndarray
    cuts: np.ndarray
    cells: Cells
    kind: np.ndarray
    coarsest: np.ndarray
    scale: np.ndarray
    character: np.ndarray
    group: np.ndarray
    owner: np.ndarray
    rays: np.ndarray
    hidden: np.ndarray
    entered: list[np.ndarray]
    left: list[np.ndarray]
    blurred: bool = False
    roles: Roles | None = None
    meetings: Meetings = Meetings()
    finest: np.ndarray | None = None
    limit: np.ndarray | None = None

    @property
    def is_seen(self) -> np.ndarray:
        """(N,) bool."""
        return self.kind == SEEN

    def count(self, kind: int) -> np.ndarray:
        """Return how many agents of a kind each frame has, (F,) int64; CULLED counts the hidden."""
        counts = np.zeros(len(self.times), np.int64)
        for block, kinds in self.cells.tables(self.kind):
            is_counted = kinds != CULLED if kind == CULLED else kinds == kind
            counts[block.begin : block.end] += is_counted.sum(axis=1)
        return len(self.group) - counts if kind == CULLED else counts

    def joined(self, block: Block) -> np.ndarray:
        """Return which agents are in sight in a frame and in the one before, (f, m) bool.

        False for all at a cut: another picture hides what changes.
        """
        is_seen = block.table(self.kind) == SEEN
        joined = np.zeros_like(is_seen)
        np.logical_and(is_seen[1:], is_seen[:-1], out=joined[1:])
        joined[self.cuts[block.begin : block.end]] = False
        return joined

    def by_block(self, measure: Callable[[Block], Any]) -> Iterator[Any]:
        """Yield what `measure` returns of each block; threads measure some beside each other."""
        blocks = self.cells.blocks
        is_alone = len(blocks) == 1  # a thread would take a tenth of a small shot's plan
        results = (
            map(measure, blocks) if is_alone else map_in_threads(measure, zip(blocks, strict=True))
        )
        for result in results:
            check_cancelled()
            yield result

    def of(self, agents: np.ndarray) -> "Survey":
        """Return the survey of these agents (m,) alone; nobody counts as entered or gone."""
        extract = self.cells.extract
        return replace(
            self,
            cells=self.cells.of(agents),
            kind=extract(self.kind, agents),
            coarsest=extract(self.coarsest, agents),
            scale=extract(self.scale, agents),
            character=extract(self.character, agents),
            finest=None if self.finest is None else extract(self.finest, agents),
            limit=None if self.limit is None else extract(self.limit, agents),
            group=self.group[agents],
            rays=self.rays * len(agents) / len(self.group),
            entered=[np.empty(0, AT_ONCE)] * len(self.times),
            left=[np.empty(0, AT_ONCE)] * len(self.times),
        )


def coarsest_within(scale: np.ndarray, bounds: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the coarsest LODs that show at most `tolerance` pixels, uint8 of the shape of `scale`.

    scale: (..., m) pixels a meter, of m agents.
    bounds: (m, K) meters, of each agent's LODs.
    """
    pixels = scale.astype(np.float64)
    level = np.zeros(scale.shape, np.uint8)
    for k in range(1, bounds.shape[1]):
        level[pixels * bounds[:, k] <= tolerance] = k
    return level


def at_tolerance(survey: Survey, bounds: np.ndarray, tolerance: float) -> Survey:
    """Return the survey with the coarsest LODs within `tolerance` pixels, or that overrides allow.

    bounds: (G, K) meters, of each group's LODs, never decreasing along a row.
    """
    coarsest = survey.coarsest.copy()
    for block, levels, scale, kind in survey.cells.tables(coarsest, survey.scale, survey.kind):
        level = coarsest_within(scale, bounds[survey.group[block.agents]], tolerance)
        if survey.finest is not None and survey.limit is not None:
            level = np.clip(level, block.table(survey.finest), block.table(survey.limit))
        np.copyto(levels, level, where=kind == SEEN)
    return replace(survey, coarsest=coarsest)
