"""A surveyed shot with its LOD meshes, and what LODs of it cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..crowd.agents import Group
from ..levels.cost_model import (
    Actors,
    Costs,
    Holdings,
    Price,
    Work,
    price,
    stored_triangles,
    work_of,
)
from .survey import SEEN, Block, Survey

# pixels as which any switch in sight counts, besides those by which it changes the picture
NOTICED = 0.25
MATTERS = 0.05  # part of the instances' cost from which on that of meshes is shared with care
UNSEEN = 255  # the LOD of an agent that is not seen


@dataclass(frozen=True)
class Meshes:
    """The LOD meshes of G groups, K LODs each.

    triangles, vertices: (G, K) float64.
    bounds: (G, K) float64 meters, how far each LOD's surface lies from the character's at most;
        never decreasing along a row.
    """

    triangles: np.ndarray
    vertices: np.ndarray
    bounds: np.ndarray

    @property
    def count(self) -> int:
        """The number of LODs."""
        return self.triangles.shape[1]


def meshes_of(groups: Sequence[Group], count: int) -> Meshes:
    """Return the measured LOD meshes of `groups`, the first `count` of each."""
    triangles, vertices, bounds = (
        np.array([getattr(group, name)[:count] for group in groups], np.float64)
        for name in ("triangles", "vertices", "bounds")
    )
    return Meshes(triangles, vertices, np.maximum.accumulate(bounds, axis=1))


@dataclass(frozen=True)
class CharacterNeeds:
    """What the F frames of a shot ask of each of L characters.

    users: (F, L) intp, seen agents that show it.
    coarsest: (F, L) intp, the coarsest LOD that all of them may show.
    staying: (F, L) intp, those of them that showed it in the frame before as well, in sight.
    pixels: (F, L) float64, the sum of the pixels that a meter of these shows.
    """

    users: np.ndarray
    coarsest: np.ndarray
    staying: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class Shot:
    """A surveyed shot, and what its LODs cost.

    costs: of the engine, on the machine that renders.
    holdings, moved_as: as of Actors.
    """

    survey: Survey
    meshes: Meshes
    costs: Costs
    holdings: Holdings = Holdings()
    moved_as: np.ndarray | None = None

    @cached_property
    def actors(self) -> Actors:
        """The characters that a build of the shot may hold."""
        owner = self.survey.owner.astype(np.intp)
        triangles = self.meshes.triangles
        stored = stored_triangles(triangles)
        return Actors(triangles, owner, self.holdings, stored, moved_as=self.moved_as)

    @cached_property
    def instance(self) -> np.ndarray:
        """(K, L) float64 seconds that one instance of each mesh takes."""
        seconds = self.costs.seconds
        each = seconds["instances"] + seconds.get("instanced", 0.0) * self.meshes.triangles
        return each.T[:, self.survey.owner]

    @cached_property
    def allowed(self) -> np.ndarray:
        """(N,) uint8, the coarsest LOD of each agent in each frame; UNSEEN where it is not seen.

        It is the survey's `coarsest`. It is finer only where a switch in the next frame would
        change the picture by more than twice the pixels that the two LODs are allowed to show, and
        never finer than overrides allow.
        """
        survey = self.survey
        allowed = np.where(survey.is_seen, survey.coarsest, UNSEEN).astype(np.uint8)
        for _ in survey.by_block(lambda block: self._refine(block, block.table(allowed))):
            pass
        return allowed

    def _refine(self, block: Block, levels: np.ndarray) -> None:
        """Make coarsest LODs (f, m) of a block finer before switches that would show too much."""
        survey = self.survey
        joined = survey.joined(block)
        f, column = np.nonzero(joined[1:] & (levels[:-1] > levels[1:]))
        bounds = self.meshes.bounds[survey.group[block.agents[column]]].T
        scale = block.table(survey.scale)
        then = scale[f, column].astype(np.float64)
        now = scale[f + 1, column].astype(np.float64)
        before = levels[f, column]
        after = levels[f + 1, column]
        rows = np.arange(len(f))
        most = np.maximum(then * bounds[before, rows], now * bounds[after, rows])
        least = 0 if survey.finest is None else block.table(survey.finest)[f, column]
        for k in range(self.meshes.count - 1, 0, -1):
            is_large = now * (bounds[k] + bounds[after, rows]) > 2 * most
            before[(before == k) & (k > np.maximum(after, least)) & is_large] = k - 1
        levels[f, column] = before

    @cached_property
    def least_shown(self) -> np.ndarray:
        """(F, K, L) int64, agents that show each LOD of each character if all show `allowed`."""
        return shown_by(self, self.allowed)

    @cached_property
    def needs_of_characters(self) -> CharacterNeeds:
        """What each frame asks of each character."""
        survey = self.survey
        agents_shown = self.least_shown
        users = agents_shown.sum(axis=1)
        coarsest = np.where(users > 0, (agents_shown > 0).argmax(axis=1), self.meshes.count - 1)
        staying = np.zeros(users.shape, np.intp)
        pixels = np.zeros(users.shape)
        for block, character, scale in survey.cells.tables(survey.character, survey.scale):
            stays = survey.joined(block)
            stays[1:] &= character[1:] == character[:-1]
            f, column = np.nonzero(stays)
            key = (block.begin + f) * users.shape[1] + character[f, column]
            staying += np.bincount(key, minlength=users.size).reshape(users.shape)
            weights = scale[f, column]
            pixels += np.bincount(key, weights, users.size).reshape(users.shape)
        return CharacterNeeds(users, coarsest, staying, pixels)

    @property
    def coarsest(self) -> np.ndarray:
        """(N,) uint8, the coarsest LODs that are allowed."""
        return self.carried(self.allowed)

    def carried(self, levels: np.ndarray) -> np.ndarray:
        """Return `levels` (N,); where an agent is not seen, the LOD with which it is seen next,
        or 0.
        """
        all_levels = np.where(self.survey.is_seen, levels, UNSEEN).astype(np.uint8)
        for _, rows in self.survey.cells.tables(all_levels):
            rows[-1][rows[-1] == UNSEEN] = 0
            for f in range(len(rows) - 2, -1, -1):
                np.copyto(rows[f], rows[f + 1], where=rows[f] == UNSEEN)
        return all_levels


class Bill:
    """What LODs of a shot cost. Figures that nobody asks for are not computed.

    levels: (N,) uint8, the LODs.
    agents_shown: (F, K, L), agents of each frame that show each LOD of each character; counted,
        where they are not given.
    """

    def __init__(
        self, shot: Shot, levels: np.ndarray, agents_shown: np.ndarray | None = None
    ) -> None:
        self.shot = shot
        self.levels = levels
        self.agents_shown = shown_by(shot, levels) if agents_shown is None else agents_shown

    @cached_property
    def price(self) -> Price:
        """Of a bake of this shot, in the engine."""
        return price(work_in(self.shot, self.agents_shown), self.shot.costs)

    @cached_property
    def mesh_seconds(self) -> np.ndarray:
        """(F, K, L), that each mesh takes in a frame that shows it.

        Also those of rays, which cost more among more triangles.
        """
        shot = self.shot
        seconds = shot.costs.seconds
        work = work_in(shot, self.agents_shown)
        traced = seconds.get("traced", 0.0) * shot.survey.rays
        rays = traced / (np.log(2) * np.maximum(work.unique, 1.0))
        triangles = shot.meshes.triangles.T[:, shot.survey.owner]
        split = seconds.get("split", 0.0) * shot.actors.split
        return ((seconds["unique"] + rays)[:, None, None] + split) * triangles

    @cached_property
    def mesh_shares(self) -> np.ndarray:
        """(F, K, L), `mesh_seconds` of each agent if all of a character showed the mesh."""
        return self.mesh_seconds / np.maximum(self.agents_shown.sum(axis=1), 1)[:, None, :]

    @cached_property
    def meshes_matter(self) -> bool:
        """Whether meshes cost so much, beside instances, that agents should share them."""
        meshes = (self.mesh_seconds * (self.agents_shown > 0)).sum()
        return bool(meshes >= MATTERS * (self.shot.instance * self.agents_shown).sum())

    @property
    def instanced(self) -> float:
        """Seconds a frame of instances."""
        return float((self.agents_shown * self.shot.instance).sum()) / len(self.agents_shown)

    @property
    def counts(self) -> np.ndarray:
        """(F, K), seen agents at each LOD."""
        return self.agents_shown.sum(axis=2)

    @property
    def triangles(self) -> np.ndarray:
        """(F,), of all seen agents."""
        return self._sum_of(self.shot.meshes.triangles)

    @property
    def vertices(self) -> np.ndarray:
        """(F,), of all seen agents."""
        return self._sum_of(self.shot.meshes.vertices)

    def _sum_of(self, table: np.ndarray) -> np.ndarray:
        return (self.agents_shown * table.T[:, self.shot.survey.owner]).sum(axis=(1, 2))

    @property
    def switches(self) -> np.ndarray:
        """(F,), agents that change their LOD in sight."""
        return self._changes[0]

    @property
    def pixels(self) -> np.ndarray:
        """(F,), the sum of the pixels by which those change the picture at most."""
        return self._changes[1]

    @property
    def most(self) -> float:
        """The most pixels of one switch."""
        return self._changes[2]

    @cached_property
    def _changes(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Each frame's switches and their pixels, (F,), and the most pixels of one."""
        frames = len(self.agents_shown)

        def measure(block: Block) -> tuple[np.ndarray, np.ndarray, float]:
            f, _, pixels = switched(self.shot, self.levels, block)
            sums = np.bincount(f, pixels, frames)
            return np.bincount(f, minlength=frames), sums, float(pixels.max(initial=0.0))

        switches = np.zeros(frames, np.intp)
        pixels = np.zeros(frames)
        most = 0.0
        for counts, sums, largest in self.shot.survey.by_block(measure):
            switches += counts
            pixels += sums
            most = max(most, largest)
        return switches, pixels, most

    @cached_property
    def error(self) -> float:
        """The most pixels by which a LOD deviates."""
        survey = self.shot.survey

        def measure(block: Block) -> float:
            bounds = self.shot.meshes.bounds.T[:, survey.group[block.agents]]
            levels = block.table(self.levels)
            scale = block.table(survey.scale)
            columns = np.arange(len(block.agents))
            is_seen = block.table(survey.kind) == SEEN
            deviations = bounds[levels, columns] * scale.astype(np.float64)
            return float(deviations.max(initial=0.0, where=is_seen))

        return max(survey.by_block(measure), default=0.0)

    @property
    def noticed(self) -> float:
        """All switches in sight, in pixels."""
        return float(self.pixels.sum() + NOTICED * self.switches.sum())

    def above(self, other: "Bill", whole: "Bill | None" = None) -> float:
        """Return what this costs more than `other`, in time, memory or instances.

        As a part of what `whole` costs, or `other`: the largest of the three.
        """
        whole = whole or other
        costs = (
            (self.price.seconds, other.price.seconds, whole.price.seconds),
            (self.price.memory, other.price.memory, whole.price.memory),
            (self.instanced, other.instanced, whole.instanced),
        )
        return max((own - least) / total if total > 0 else 0.0 for own, least, total in costs)


def shown_by(shot: Shot, levels: np.ndarray) -> np.ndarray:
    """Return how many seen agents show each LOD of each character by `levels` (N,), (F, K, L)
    int64.
    """
    survey = shot.survey
    count = shot.meshes.count
    characters = len(survey.owner)
    counts = np.zeros((len(survey.times), count + 1, characters), np.int64)

    def measure(block: Block) -> np.ndarray:
        frame = np.arange(block.end - block.begin)[:, None]
        is_seen = block.table(survey.kind) == SEEN
        level = np.where(is_seen, block.table(levels), np.uint8(count))  # the last: nobody sees it
        key = ((count + 1) * frame + level) * characters + block.table(survey.character)
        shape = len(frame), count + 1, characters
        return np.bincount(key.ravel(), minlength=np.prod(shape)).reshape(shape)

    for block, of_block in zip(survey.cells.blocks, survey.by_block(measure), strict=True):
        counts[block.begin : block.end] += of_block
    return counts[:, :count]


def work_in(shot: Shot, shown: np.ndarray) -> Work:
    """Return the work of a bake of the shot that shows `shown` (F, K, L) agents."""
    return work_of(shot.actors, shown, shot.survey.rays, known=True)


def switched(
    shot: Shot, levels: np.ndarray, block: Block
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (frames, agents, pixels) of all changes of LODs in sight of a block, (s,) each.

    pixels: by how many the picture changes at most. Each LOD lies off the character by its bound
        at most, so two lie apart by the sum of theirs.
    """
    survey = shot.survey
    bounds = shot.meshes.bounds
    rows = block.table(levels)
    is_switched = survey.joined(block)
    is_switched[1:] &= rows[1:] != rows[:-1]
    f, column = np.nonzero(is_switched)
    agents = block.agents[column]
    group = survey.group[agents]
    apart = bounds[group, rows[f - 1, column]] + bounds[group, rows[f, column]]
    scale = block.table(survey.scale)[f, column]
    return block.begin + f, agents, scale.astype(np.float64) * apart
