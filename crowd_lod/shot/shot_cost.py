"""A surveyed shot with its LOD meshes, and what LODs of it cost."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
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
from .survey import SEEN, Survey

# pixels as which any switch in sight counts, besides those by which it changes the picture
NOTICED = 0.25
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
        """(F, n) uint8, the coarsest LOD of each agent in each frame; UNSEEN where it is not seen.

        It is the survey's `coarsest`. It is finer only where a switch in the next frame would
        change the picture by more than twice the pixels that the two LODs are allowed to show, and
        never finer than exceptions allow.
        """
        survey = self.survey
        bounds = self.meshes.bounds
        coarsest = np.where(survey.is_seen, survey.coarsest, UNSEEN).astype(np.uint8)
        for f in range(1, len(coarsest)):
            agents = np.flatnonzero(
                survey.joined(f) & (survey.coarsest[f - 1] > survey.coarsest[f])
            )
            group = survey.group[agents]
            (then, now) = survey.scale[f - 1 : f + 1, agents].astype(np.float64)
            before = coarsest[f - 1, agents]
            after = coarsest[f, agents]
            most = np.maximum(then * bounds[group, before], now * bounds[group, after])
            least = 0 if survey.finest is None else survey.finest[f - 1, agents]
            for k in range(self.meshes.count - 1, 0, -1):
                before[
                    (before == k)
                    & (k > np.maximum(after, least))
                    & (now * (bounds[group, k] + bounds[group, after]) > 2 * most)
                ] = k - 1
            coarsest[f - 1, agents] = before
        return coarsest

    @property
    def coarsest(self) -> np.ndarray:
        """(F, n) uint8, the coarsest LODs that are allowed."""
        return self.carried(self.allowed)

    def carried(self, levels: np.ndarray) -> np.ndarray:
        """Return `levels` (F, n); where an agent is not seen, the LOD with which it is seen next,
        or 0.
        """
        all_levels = np.where(self.survey.is_seen, levels, UNSEEN)
        all_levels[-1][all_levels[-1] == UNSEEN] = 0
        for f in range(len(all_levels) - 2, -1, -1):
            np.copyto(all_levels[f], all_levels[f + 1], where=all_levels[f] == UNSEEN)
        return all_levels


@dataclass(frozen=True)
class Bill:
    """What the LODs of a shot cost.

    triangles, vertices: (F,), of all seen agents.
    counts: (F, K), seen agents at each LOD.
    switches: (F,), agents that change their LOD in sight.
    pixels: (F,), the sum of the pixels by which those change the picture at most.
    most: the most pixels of one switch.
    error: the most pixels by which a LOD deviates.
    agents_shown: (F, K, L), agents of each frame that show each LOD of each character.
    price: of a bake of this shot, in the engine.
    instanced: seconds a frame of instances.
    """

    triangles: np.ndarray
    vertices: np.ndarray
    counts: np.ndarray
    switches: np.ndarray
    pixels: np.ndarray
    most: float
    error: float
    agents_shown: np.ndarray
    price: Price
    instanced: float

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


def bill(shot: Shot, levels: np.ndarray) -> Bill:
    """Return what `levels` (F, n) uint8 cost in the shot."""
    survey = shot.survey
    meshes = shot.meshes
    frames = len(survey.times)
    agents_shown = shown_by(shot, levels)

    def measure_frame(f: int) -> tuple[int, float, float, float]:
        agents = np.flatnonzero(survey.kind[f] == SEEN)
        level = levels[f, agents]
        error = (
            survey.scale[f, agents].astype(np.float64) * meshes.bounds[survey.group[agents], level]
        )
        changed, change = switched(shot, levels, f)
        return (
            len(changed),
            float(change.sum()),
            float(change.max(initial=0.0)),
            float(error.max(initial=0.0)),
        )

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        switches, pixels, most, error = zip(*pool.map(measure_frame, range(frames)), strict=True)
    each = [table.T[:, survey.owner] for table in (meshes.triangles, meshes.vertices)]
    triangles, vertices = ((agents_shown * table).sum(axis=(1, 2)) for table in each)
    return Bill(
        triangles=triangles,
        vertices=vertices,
        counts=agents_shown.sum(axis=2),
        switches=np.array(switches),
        pixels=np.array(pixels),
        most=max(most),
        error=max(error),
        agents_shown=agents_shown,
        price=price(work_in(shot, agents_shown), shot.costs),
        instanced=float((agents_shown * shot.instance).sum()) / frames,
    )


def shown_by(shot: Shot, levels: np.ndarray) -> np.ndarray:
    """Return how many seen agents show each LOD of each character by `levels` (F, n), (F, K, L)
    int64.
    """
    survey = shot.survey
    characters = len(shot.survey.owner)
    counts = np.zeros((len(survey.times), shot.meshes.count, characters), np.int64)
    for f in range(len(counts)):
        agents = np.flatnonzero(survey.kind[f] == SEEN)
        key = levels[f, agents].astype(np.intp) * characters + survey.character[f, agents]
        counts[f] = np.bincount(key, minlength=counts[f].size).reshape(counts[f].shape)
    return counts


def work_in(shot: Shot, shown: np.ndarray) -> Work:
    """Return the work of a bake of the shot that shows `shown` (F, K, L) agents."""
    return work_of(shot.actors, shown, shot.survey.rays, known=True)


def switched(shot: Shot, levels: np.ndarray, f: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (agents (m,) that change their LOD in sight in frame f, by how many pixels at most).

    Each LOD lies off the character by its bound at most, so two lie apart by the sum of theirs.
    """
    survey = shot.survey
    bounds = shot.meshes.bounds
    agents = np.flatnonzero(survey.joined(f) & (levels[f] != levels[f - 1]))
    group = survey.group[agents]
    apart = bounds[group, levels[f - 1, agents]] + bounds[group, levels[f, agents]]
    return agents, survey.scale[f, agents].astype(np.float64) * apart
