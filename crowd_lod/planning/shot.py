"""The shot plan: every LOD of a whole shot, decided at once.

A dynamic programme over frames (Viterbi 1967) finds each agent's LODs: never coarser than allowed,
at the least sum of what the LODs cost and of `weight` times the pixels by which switches in sight
change the picture. A mesh that a frame shows costs once, however many agents show it. See
docs/notes/shot_plan.md on how that cost is shared, and on the lower bound.
"""

import os
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..crowd.agents import Group
from ..levels.cost_model import SECONDS, Actors, Price, Work, price, work_of
from ..progress import share
from .survey import SEEN, Survey

TOGETHER = 8192  # agents decided together: their rows stay in the processor's cache
SAMPLE = 10_000  # agents from which the weight of switches is found
STEPS = 6  # of the search for it, each by a factor of FACTOR
FACTOR = 4.0
NEARLY = 1e-3  # part of its share that a mesh costs which the frame shows anyway
NOTICED = 0.25  # pixels as which any switch in sight counts, besides those by which it changes the picture
MATTERS = 0.05  # part of the instances' cost from which on that of meshes is shared with care
UNSEEN = 255  # the LOD of an agent that is not seen


@dataclass(frozen=True)
class Meshes:
    """The LOD meshes of G groups, K LODs each.

    triangles, vertices: (G, K) float64.
    bounds: (G, K) float64 metres, how far each LOD's surface lies from the character's at most;
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
        np.array([getattr(group, name)[:count] for group in groups], np.float64) for name in ("triangles", "vertices", "bounds")
    )
    return Meshes(triangles, vertices, np.maximum.accumulate(bounds, axis=1))


@dataclass(frozen=True)
class Shot:
    """A surveyed shot, and what its LODs cost.

    engine: one of cost_model.NAMES.
    """

    survey: Survey
    meshes: Meshes
    engine: str

    @cached_property
    def actors(self) -> Actors:
        """The characters that a build of the shot may hold, each with one rig."""
        return Actors(self.meshes.triangles, self.survey.owner.astype(np.intp), np.ones(len(self.meshes.triangles)))

    @cached_property
    def instance(self) -> np.ndarray:
        """(K, L) float64 seconds that one instance of each mesh takes."""
        seconds = SECONDS[self.engine]
        each = seconds["instances"] + seconds.get("instanced", 0.0) * self.meshes.triangles
        return each.T[:, self.survey.owner]

    @cached_property
    def allowed(self) -> np.ndarray:
        """(F, n) uint8, the coarsest LOD of each agent in each frame; UNSEEN where it is not seen.

        It is the survey's `coarsest`. It is finer only where a switch in the next frame would
        change the picture by more than twice the pixels that the two LODs are allowed to show.
        """
        survey, bounds = self.survey, self.meshes.bounds
        found = np.where(survey.seen, survey.coarsest, UNSEEN).astype(np.uint8)
        for f in range(1, len(found)):
            agents = np.flatnonzero(survey.joined(f) & (survey.coarsest[f - 1] > survey.coarsest[f]))
            group, (then, now) = survey.group[agents], survey.scale[f - 1 : f + 1, agents].astype(np.float64)
            before, after = found[f - 1, agents], found[f, agents]
            most = np.maximum(then * bounds[group, before], now * bounds[group, after])
            for k in range(self.meshes.count - 1, 0, -1):
                before[(before == k) & (k > after) & (now * (bounds[group, k] + bounds[group, after]) > 2 * most)] = k - 1
            found[f - 1, agents] = before
        return found

    @property
    def coarsest(self) -> np.ndarray:
        """(F, n) uint8, `allowed`; where an agent is not seen, the LOD with which it is seen next, or 0."""
        found = self.allowed.copy()
        found[-1][found[-1] == UNSEEN] = 0
        for f in range(len(found) - 2, -1, -1):
            np.copyto(found[f], found[f + 1], where=found[f] == UNSEEN)
        return found


@dataclass(frozen=True)
class Bill:
    """What the LODs of a shot cost.

    triangles, vertices: (F,), of all seen agents.
    counts: (F, K), seen agents at each LOD.
    switches: (F,), agents that change their LOD in sight.
    pixels: (F,), the sum of the pixels by which those change the picture at most.
    most: the most pixels of one switch.
    error: the most pixels by which a LOD deviates.
    shown: (F, K, L), agents of each frame that show each LOD of each character.
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
    shown: np.ndarray
    price: Price
    instanced: float

    def above(self, other: "Bill") -> float:
        """Return by which part this costs more than `other`: in time, memory or instances."""
        pairs = (
            (self.price.seconds, other.price.seconds),
            (self.price.memory, other.price.memory),
            (self.instanced, other.instanced),
        )
        return max(own / least - 1 if least > 0 else 0.0 for own, least in pairs)


def bill(shot: Shot, levels: np.ndarray) -> Bill:
    """Return what `levels` (F, n) uint8 cost in the shot."""
    survey, meshes = shot.survey, shot.meshes
    frames, count, characters = len(survey.times), meshes.count, len(survey.owner)
    shown = np.zeros((frames, count, characters), np.int64)

    def one(f: int) -> tuple[int, float, float, float]:
        agents = np.flatnonzero(survey.kind[f] == SEEN)
        level = levels[f, agents]
        key = level.astype(np.intp) * characters + survey.character[f, agents]
        shown[f] = np.bincount(key, minlength=count * characters).reshape(count, characters)
        error = survey.scale[f, agents].astype(np.float64) * meshes.bounds[survey.group[agents], level]
        changed, change = switched(shot, levels, f)
        return len(changed), float(change.sum()), float(change.max(initial=0.0)), float(error.max(initial=0.0))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        switches, pixels, most, error = zip(*pool.map(one, range(frames)), strict=True)
    each = [table.T[:, survey.owner] for table in (meshes.triangles, meshes.vertices)]
    triangles, vertices = ((shown * table).sum(axis=(1, 2)) for table in each)
    return Bill(
        triangles=triangles,
        vertices=vertices,
        counts=shown.sum(axis=2),
        switches=np.array(switches),
        pixels=np.array(pixels),
        most=max(most),
        error=max(error),
        shown=shown,
        price=price(work_in(shot, shown), shot.engine),
        instanced=float((shown * shot.instance).sum()) / frames,
    )


def work_in(shot: Shot, shown: np.ndarray) -> Work:
    """Return the work of a bake of the shot that shows `shown` (F, K, L) agents."""
    return work_of(shot.actors, shown, shot.survey.rays, known=True)


def switched(shot: Shot, levels: np.ndarray, f: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (agents (m,) that change their LOD in sight in frame f, by how many pixels at most).

    Each LOD lies off the character by its bound at most, so two lie apart by the sum of theirs.
    """
    survey, bounds = shot.survey, shot.meshes.bounds
    agents = np.flatnonzero(survey.joined(f) & (levels[f] != levels[f - 1]))
    group = survey.group[agents]
    apart = bounds[group, levels[f - 1, agents]] + bounds[group, levels[f, agents]]
    return agents, survey.scale[f, agents].astype(np.float64) * apart


def programme(shot: Shot, table: np.ndarray, weight: float, agents: slice) -> tuple[np.ndarray, float]:
    """Return (levels (F, m) uint8, their cost) of `agents`, by dynamic programming.

    An agent that is not seen has the LOD with which it is seen next.
    table: (1 or F, K, L) float32, the cost of an agent that shows a LOD of a character.
    weight: the cost of a pixel by which a switch changes the picture.
    """
    survey, count = shot.survey, shot.meshes.count
    frames, group = len(survey.times), survey.group[agents]
    apart = shot.meshes.bounds.T[:, group].astype(np.float32)
    cost = np.zeros((count, len(group)), np.float32)
    came = np.empty((frames, count, len(group)), np.uint8)
    numbers = np.arange(count, dtype=np.uint8)[:, None]
    least, via = np.empty(len(group), np.float32), np.empty(len(group), np.uint8)
    for f in range(frames):
        joined = survey.joined(f, agents)
        pixels = np.where(joined, survey.scale[f, agents], np.float16(0)).astype(np.float32) * np.float32(weight)
        change = apart * pixels
        left = cost + change
        np.copyto(least, left[0])
        via[:] = 0
        for k in range(1, count):
            better = left[k] < least
            np.copyto(least, left[k], where=better)
            np.copyto(via, np.uint8(k), where=better)
        least += joined * np.float32(weight * NOTICED)
        change += least
        switch = change < cost
        np.copyto(cost, change, where=switch)
        np.copyto(came[f], np.where(switch, via, numbers))
        allowed = shot.allowed[f, agents]
        seen = allowed != UNSEEN
        own = table[min(f, len(table) - 1)].take(survey.character[f, agents], axis=1) * seen
        own[numbers > allowed] = np.inf
        cost += own
    return _traced(came, cost), float(cost.min(axis=0).sum(dtype=np.float64))


def _traced(came: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return the levels (F, m) that lead to the least cost.

    came: (F, K, m) uint8, the LOD in the frame before from which each LOD is reached.
    cost: (K, m), in the end.
    """
    levels = np.empty((len(came), cost.shape[1]), np.uint8)
    now, agents = cost.argmin(axis=0).astype(np.uint8), np.arange(cost.shape[1])
    for f in range(len(came) - 1, -1, -1):
        levels[f] = now
        now = came[f][now, agents]
    return levels


def decided(shot: Shot, table: np.ndarray, weight: float) -> Generator[float, None, tuple[np.ndarray, float]]:
    """Decide on all agents by `programme`: yield the progress, return (levels (F, n), cost)."""
    agents = len(shot.survey.group)
    parts = [slice(begin, min(begin + TOGETHER, agents)) for begin in range(0, agents, TOGETHER)]
    levels, cost = np.empty(shot.survey.kind.shape, np.uint8), 0.0
    _ = shot.allowed  # found once, before threads ask for it
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done, (part, (own, paid)) in enumerate(
            zip(parts, pool.map(lambda part: programme(shot, table, weight, part), parts), strict=True)
        ):
            levels[:, part] = own
            cost += paid
            yield (done + 1) / len(parts)
    return levels, cost


@dataclass(frozen=True)
class ShotPlan:
    """The decision on a shot.

    levels: (F, n) uint8, of each agent in each frame; where it is not seen, the one with which it
        is seen next.
    bill: what they cost.
    thresholds: what the LODs that the policy gives frame by frame cost.
    weight: seconds that one pixel of change counted as.
    bound: part by which cost and switches together may lie above the least possible, at most.
    """

    levels: np.ndarray
    bill: Bill
    thresholds: Bill
    weight: float
    bound: float


def decide(shot: Shot, avoid: float = 0.05) -> Generator[float, None, ShotPlan]:
    """Decide on all LODs of the shot: yield the progress, return the ShotPlan.

    avoid: the part by which time, memory and instances may cost more than with thresholds, to avoid
        switches in sight. 0 still avoids those that cost nothing. They cost more than that only
        where all LODs that are allowed do.
    """
    thresholds, avoid = _limit(shot, avoid)
    weight = yield from share(_weight(shot, avoid), 0.0, 0.4)
    for step in range(STEPS):
        levels, shared = yield from share(solved(shot, thresholds, weight), 0.4, 0.8)
        found = bill(shot, levels)
        if found.above(thresholds) <= avoid or step == STEPS - 1:
            break
        weight /= 1.5  # the sample promised more than the whole keeps
    if found.above(thresholds) > avoid:
        levels = shot.coarsest
        found = bill(shot, levels)
    least = yield from share(lower_bound(shot, weight, shared), 0.8, 1.0)
    paid = _objective(found, weight)
    return ShotPlan(levels, found, thresholds, weight, max(paid / least - 1, 0.0) if least > 0 else 0.0)


def _limit(shot: Shot, avoid: float) -> tuple[Bill, float]:
    """Return the bill of thresholds, and the part by which a plan may cost more.

    That is more than `avoid` where the coarsest LODs that are allowed cost more, for thresholds
    may switch by more than twice the tolerance.
    """
    thresholds = bill(shot, shot.survey.coarsest)
    if np.array_equal(shot.coarsest, shot.survey.coarsest):
        return thresholds, avoid
    return thresholds, max(avoid, bill(shot, shot.coarsest).above(thresholds))


def _objective(found: Bill, weight: float) -> float:
    """Return the seconds of all frames, and those as which switches count."""
    return found.price.seconds * len(found.switches) + weight * float(found.pixels.sum() + NOTICED * found.switches.sum())


def _weight(shot: Shot, avoid: float) -> Generator[float, None, float]:
    """Find the largest weight of switches that costs no more than `avoid`, from a sample."""
    some, _ = sampled(shot, SAMPLE)
    thresholds, avoid = _limit(some, avoid)
    unit = thresholds.price.seconds * len(some.survey.times) / max(thresholds.counts.sum(), 1)
    low, high = unit * FACTOR**-STEPS, unit * FACTOR**STEPS
    for step in range(2 * STEPS):
        middle = float(np.sqrt(low * high))
        levels, _ = yield from share(solved(some, thresholds, middle), step / (2 * STEPS), (step + 1) / (2 * STEPS))
        if bill(some, levels).above(thresholds) <= avoid:
            low = middle
        else:
            high = middle
        if high < 1.1 * low:
            break
    return low


def sampled(shot: Shot, most: int) -> tuple[Shot, slice]:
    """Return the shot of at most `most` of its agents, evenly, and which they are."""
    some = slice(None, None, max(-(-len(shot.survey.group) // most), 1))
    return shot if some.step == 1 else Shot(shot.survey.of(some), shot.meshes, shot.engine), some


def solved(shot: Shot, thresholds: Bill, weight: float) -> Generator[float, None, tuple[np.ndarray, float | None]]:
    """Return (the levels of least cost that are found for one weight of switches, a lower bound).

    The bound is that of agents that share meshes evenly, or None where it was not found on the way.

    Where meshes cost much, two rounds: in the first an agent pays its share of a mesh, as if all
    that may show it did. In the second the meshes of the first cost next to nothing, and all others
    their whole price.
    """
    unique = _unique(shot, thresholds)
    shares = unique / np.maximum(thresholds.shown.sum(axis=1), 1)[:, None, :]
    levels, shared = yield from share(decided(shot, _table(shot, shares), weight), 0.0, 0.5)
    if (
        "traced" not in SECONDS[shot.engine]
        and (unique * (thresholds.shown > 0)).sum() < MATTERS * (shot.instance * thresholds.shown).sum()
    ):
        return levels, shared
    found = bill(shot, levels)
    again, _ = yield from share(decided(shot, _table(shot, np.where(found.shown > 0, NEARLY * shares, unique)), weight), 0.5, 1.0)
    return min((levels, again), key=lambda each: _objective(bill(shot, each), weight)), None


def _unique(shot: Shot, thresholds: Bill) -> np.ndarray:
    """Return the seconds that each mesh takes in a frame that shows it, (F, K, L).

    Also those of rays, which cost more among more triangles.
    """
    seconds = SECONDS[shot.engine]
    work = work_in(shot, thresholds.shown)
    rays = seconds.get("traced", 0.0) * shot.survey.rays / (np.log(2) * np.maximum(work.unique, 1.0))
    return (seconds["unique"] + rays)[:, None, None] * shot.meshes.triangles.T[:, shot.survey.owner]


def _table(shot: Shot, unique: np.ndarray) -> np.ndarray:
    return (shot.instance + unique).astype(np.float32)


def lower_bound(shot: Shot, weight: float, shared: float | None = None) -> Generator[float, None, float]:
    """Return seconds that no plan of the shot can go below, switches counted by `weight`.

    Each frame shows of each character a LOD as fine as the finest that one of its agents needs, at
    least. And if all agents share a mesh's cost evenly, they pay no more than it costs, so that the
    least sum of their own costs is none that a plan can go below.
    """
    survey, characters = shot.survey, len(shot.survey.owner)
    frames, each = len(survey.times), shot.meshes.triangles.T[:, survey.owner]
    finest, seen = np.full((frames, characters), shot.meshes.count, np.intp), np.zeros((frames, characters))
    instanced = np.zeros(frames)
    for f in range(frames):
        agents = np.flatnonzero(survey.kind[f] == SEEN)
        own, needed = survey.character[f, agents], shot.allowed[f, agents]
        np.minimum.at(finest[f], own, needed)
        seen[f] = np.bincount(own, minlength=characters)
        instanced[f] = each[needed, own].sum()
    least = np.where(seen > 0, np.append(each, np.zeros((1, characters)), axis=0)[finest, np.arange(characters)], 0.0)
    unique = SECONDS[shot.engine]["unique"] * each / np.maximum(seen, 1)[:, None, :]
    if shared is None:
        _, shared = yield from decided(shot, _table(shot, unique), weight)
    work = Work(
        posed=float(least.max(axis=0).sum()),
        unique=least.sum(axis=1),
        instances=seen.sum(axis=1),
        instanced=instanced,
        rigs=float((seen > 0).any(axis=0).sum()),
        rays=survey.rays,
    )
    alone = replace(work, posed=0.0, rigs=0.0, rays=0.0)
    whole, parts = (frames * price(own, shot.engine).seconds for own in (work, alone))
    return whole - parts + max(parts, shared)
