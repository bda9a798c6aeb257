"""The shot plan: every LOD of a whole shot, decided at once.

A dynamic program over frames (Viterbi 1967) finds each agent's LODs: never coarser than allowed,
at the least sum of what the LODs cost and of `weight` times the pixels by which switches in sight
change the picture. A mesh that a frame shows costs once, however many agents show it. See
docs/notes/shot_plan.md on how that cost is shared, and on the lower bound.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..levels import cost_model
from ..progress import Workload
from .shot_cost import NOTICED, UNSEEN, Bill, Shot, work_in
from .survey import TOGETHER, Block

# agents from which the weight of switches is found, or a hundredth of many; where they share meshes
SAMPLE = 2000
SHARING = 20_000
STEPS = 6  # of the search for it, each by a factor of FACTOR
FACTOR = 4.0
# About what the parts of a plan cost: to search the weight, to solve by it, to bound it from below
SEARCHED, SOLVED, BOUNDED = 2.0, 2.0, 1.0
NEARLY = 1e-3  # part of its share that a mesh costs which the frame shows anyway


def choices_of(table: np.ndarray) -> np.ndarray:
    """Return (F, K, (K + 1) L) float32, what each LOD costs an agent by its coarsest LOD.

    table: (F, K, L) float32, the cost of an agent that shows a LOD of a character.

    The column k L + c is of agents that show character c and may be as coarse as LOD k: coarser
    ones are infinite. The last L are of agents that are not seen: 0.
    """
    count = table.shape[1]
    numbers = np.arange(count)
    finer, coarser = np.nonzero(numbers[:, None] < numbers)
    choices = np.zeros((len(table), count, count + 1, table.shape[2]), np.float32)
    choices[:, :, :count] = table[:, :, None]
    choices[:, coarser, finer] = np.inf
    return choices.reshape(len(table), count, -1)


def program(
    shot: Shot, choices: np.ndarray, weight: float, block: Block
) -> tuple[np.ndarray, float]:
    """Return (levels (f, m) uint8, their cost) of a block of agents, by dynamic programming.

    An agent that is not seen has the LOD with which it is seen next.
    choices: (1 or F, K, (K + 1) L), of `choices_of`.
    weight: the cost of a pixel by which a switch changes the picture.
    block: m agents, and the f frames in which they are seen.
    """
    survey = shot.survey
    count = shot.meshes.count
    allowed = block.table(shot.allowed)
    character = block.table(survey.character)
    scale = block.table(survey.scale)
    finest = None if survey.finest is None else block.table(survey.finest)
    joined = survey.joined(block)
    apart = shot.meshes.bounds.T[:, survey.group[block.agents]].astype(np.float32)
    numbers = np.arange(count, dtype=np.uint8)[:, None]
    run = max(TOGETHER // len(block.agents), 1)  # frames whose columns stay in the cache

    def steps() -> Iterator[Step]:
        for f in range(len(allowed)):
            if f % run == 0:
                frames = slice(f, f + run)
                columns = np.minimum(allowed[frames], count).astype(np.intp) * len(survey.owner)
                columns += character[frames]
                fees = joined[frames] * np.float32(weight)
                pixels = scale[frames].astype(np.float32) * fees
                fees *= NOTICED
            of_frame = choices[min(block.begin + f, len(choices) - 1)]
            cost = of_frame.take(columns[f % run], axis=1, mode="clip")
            if finest is not None:
                finer = (numbers < finest[f]) & (allowed[f] != UNSEEN)
                np.copyto(cost, np.float32(np.inf), where=finer)
            yield cost, apart * pixels[f % run], fees[f % run]

    return cheapest_path(steps(), len(allowed))


# Of one frame: (K, m) float32 what each LOD costs; (K, m) float32 what a switch to it or from it
# costs, so that one from i to j costs the sum of the two; (m,) float32 what each switch adds.
Step = tuple[np.ndarray, np.ndarray, np.ndarray]


def cheapest_path(steps: Iterable[Step], frames: int) -> tuple[np.ndarray, float]:
    """Return (the LODs (F, m) uint8 of least cost, their cost) of m that switch independently."""
    total = np.zeros(0)
    origins = np.empty(0)
    switches = np.empty(0)
    for f, (cost, change, fee) in enumerate(steps):
        if f == 0:
            total = np.zeros_like(cost)
            origins = np.empty((frames, *cost.shape), bool)
            switches = np.empty_like(origins)
        left = total + change
        least = left.min(axis=0)
        np.equal(left, least, out=origins[f])
        change += least + fee
        np.less(change, total, out=switches[f])
        np.minimum(total, change, out=total)
        total += cost
    return _traced(origins, switches, total), float(total.min(axis=0).sum(dtype=np.float64))


def _traced(origins: np.ndarray, switches: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Return the levels (F, m) that lead to the least cost.

    origins: (F, K, m) bool, the LODs in the frame before from which a switch is cheapest.
    switches: (F, K, m) bool, whether each LOD is reached by a switch.
    cost: (K, m), in the end.
    """
    levels = np.empty((len(origins), cost.shape[1]), np.uint8)
    now = cost.argmin(axis=0)
    agents = np.arange(len(now))
    for f in range(len(origins) - 1, -1, -1):
        levels[f] = now
        switching = np.flatnonzero(switches[f].ravel()[now * len(now) + agents])
        now[switching] = origins[f][:, switching].argmax(axis=0)
    return levels


def by_character(shot: Shot, unique: np.ndarray, weight: float) -> np.ndarray:
    """Return the LODs (N,) uint8 of least cost with one LOD of each character in a frame.

    It is as fine as each of the character's agents needs, and its agents switch together.
    unique: (F, K, L) seconds of each mesh. weight: as of `program`.
    """
    survey = shot.survey
    bounds = shot.meshes.bounds.T[:, survey.owner]
    needs = shot.needs_of_characters
    users = needs.users[:, None]
    cost = np.where(users > 0, unique, 0.0) + users * shot.instance
    cost[np.arange(len(bounds))[:, None] > needs.coarsest[:, None]] = np.inf
    change = weight * needs.pixels[:, None] * bounds
    fee = weight * NOTICED * needs.staying
    columns = (values.astype(np.float32) for values in (cost, change, fee))
    path, _ = cheapest_path(zip(*columns, strict=True), len(survey.times))
    levels = np.empty_like(survey.coarsest)
    for block, rows, character in survey.cells.tables(levels, survey.character):
        frame = np.arange(block.begin, block.end)[:, None]
        rows[:] = path[frame, character]
    if survey.finest is not None:
        levels = np.maximum(levels, survey.finest)
    return shot.carried(levels)


def decided(
    shot: Shot, table: np.ndarray, weight: float
) -> Generator[float, None, tuple[np.ndarray, float]]:
    """Decide on all agents by `program`: yield the progress, return (levels (N,), cost)."""
    survey = shot.survey
    levels = np.zeros_like(survey.coarsest)
    cost = 0.0
    choices = choices_of(table)
    blocks = survey.cells.blocks
    _ = shot.allowed  # found once, before threads ask for it
    programs = survey.by_block(lambda block: program(shot, choices, weight, block))
    work = Workload(len(blocks))
    for block, (block_levels, paid) in zip(blocks, programs, strict=True):
        block.table(levels)[:] = block_levels
        cost += paid
        yield work.did(1)
    return levels, cost


@dataclass(frozen=True)
class ShotPlan:
    """The decision on a shot.

    levels: (N,) uint8, of each agent in each frame; where it is not seen, the one with which it
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


def decide(shot: Shot, pop_reduction: float = 0.05) -> Generator[float, None, ShotPlan]:
    """Decide on all LODs of the shot: yield the progress, return the ShotPlan.

    pop_reduction: the part by which time, memory and instances may cost more than the thresholds'
        LODs, to avoid switches in sight. 0 still avoids those that cost nothing.

    Of the plans that the ways to share meshes lead to (ways_of), it is the one whose switches are
    noticed least. It has no more switches than thresholds have, and changes no more pixels by them,
    unless that costs more or a switch would show more than `Shot.allowed` lets it.
    """
    limit = limit_of(shot, pop_reduction)
    # where agents share meshes that cost much, few agents would share them less
    few = SHARING if limit.thresholds.meshes_matter else SAMPLE
    sample, _ = sampled(shot, max(few, len(shot.survey.group) // 100))
    sample_limit = limit if sample is shot else limit_of(sample, pop_reduction)
    ways = ways_of(limit.thresholds)
    work = Workload((SEARCHED + SOLVED) * len(ways) + BOUNDED)
    found = []
    for way in ways:
        searching = _least_noticed(way, limit, sample_limit)
        found.append((yield from work.take(searching, SEARCHED + SOLVED)))
    best = min(found, key=limit.rank)
    if limit.is_broken_by(best.bill):
        best = replace(best, bill=Bill(shot, shot.coarsest))
    work.announce(BOUNDED)
    bounding = lower_bound(shot, best.weight, best.shared)
    least = yield from work.take(bounding, BOUNDED)
    paid = objective(best.bill, best.weight)
    bound = max(paid / least - 1, 0.0) if least > 0 else 0.0
    return ShotPlan(best.bill.levels, best.bill, limit.thresholds, best.weight, bound)


@dataclass(frozen=True)
class Solution:
    """LODs of about the least cost by one weight of switches, found in one way.

    shared: a lower bound, that of agents that share meshes evenly; None where it was not found on
        the way.
    """

    bill: Bill
    weight: float
    shared: float | None = None


@dataclass(frozen=True)
class Limit:
    """What a plan may cost, and whether it pops less than thresholds.

    thresholds: what the LODs cost that the policy gives frame by frame.
    pop_reduction: the part by which a plan may cost more.
    """

    thresholds: Bill
    pop_reduction: float

    def holds(self, found: Bill) -> bool:
        """Return whether a plan may cost as much as `found`."""
        return found.above(self.thresholds) <= self.pop_reduction

    def is_broken_by(self, found: Bill) -> bool:
        """Return whether `found` costs too much, or pops more than thresholds."""
        return not self.holds(found) or self._pops_more(found)

    def rank(self, solution: Solution) -> tuple[bool, float]:
        """Return the key by which the best of several solutions is the least."""
        return self.is_broken_by(solution.bill), solution.bill.noticed

    def _pops_more(self, found: Bill) -> bool:
        switches = found.switches.sum() > self.thresholds.switches.sum()
        return bool(switches or found.pixels.sum() > self.thresholds.pixels.sum())


def limit_of(shot: Shot, pop_reduction: float) -> Limit:
    """Return what a plan may cost with this part paid to avoid switches in sight."""
    thresholds = Bill(shot, shot.survey.coarsest)
    least = Bill(shot, shot.allowed, shot.least_shown)
    return Limit(thresholds, max(pop_reduction, least.above(thresholds)))


def objective(found: Bill, weight: float) -> float:
    """Return the seconds of all frames, and those as which switches count."""
    return found.price.seconds * len(found.switches) + weight * found.noticed


# A way from (shot, thresholds, weight of switches) to LODs of about the least cost.
Way = Callable[[Shot, Bill, float], Generator[float, None, Solution]]


def _least_noticed(way: Way, limit: Limit, sample_limit: Limit) -> Generator[float, None, Solution]:
    """Return the solution by the largest weight of switches whose cost the limit holds.

    Its cost is above the limit where no weight was found to hold it.
    sample_limit: of some agents of the shot, by which the weight is searched.
    """
    shot = limit.thresholds.shot
    work = Workload(SEARCHED + SOLVED)
    searching = search_weight(way, sample_limit.thresholds, sample_limit.holds)
    weight, found = yield from work.take(searching, SEARCHED)
    work.announce(SOLVED)
    if found is not None and sample_limit is limit:
        solution = found
    else:
        solution = yield from work.take(way(shot, limit.thresholds, weight), SOLVED)
    for _ in range(STEPS - 1):
        if limit.holds(solution.bill):
            break
        weight /= 1.5  # the sample promised more than the whole keeps
        # few plans are solved again: the progress stands meanwhile
        solution = yield from work.take(way(shot, limit.thresholds, weight), 0.0)
    return solution


def search_weight(
    way: Way, thresholds: Bill, holds: Callable[[Bill], bool]
) -> Generator[float, None, tuple[float, Solution | None]]:
    """Return (the largest weight of switches whose plan is one that holds, that plan).

    No plan is returned where none was found to hold: the weight is then the least of the search.
    """
    shot = thresholds.shot
    unit = thresholds.price.seconds * len(shot.survey.times) / max(thresholds.counts.sum(), 1)
    low = unit * FACTOR**-STEPS
    high = unit * FACTOR**STEPS
    best = None
    work = Workload(2 * STEPS)
    weight = high  # costs do not always rise with it: without any switch a plan may be cheap again
    for _ in range(2 * STEPS):
        solution = yield from work.take(way(shot, thresholds, weight), 1)
        if holds(solution.bill):
            low = weight
            best = solution
        else:
            high = weight
        if high < 1.1 * low:
            break
        weight = float(np.sqrt(low * high))
    return low, best


def sampled(shot: Shot, most: int) -> tuple[Shot, np.ndarray]:
    """Return the shot of at most `most` of its agents, evenly, and which they are, (m,) intp."""
    count = len(shot.survey.group)
    agents = np.arange(count)[:: max(-(-count // most), 1)]
    return shot if len(agents) == count else replace(shot, survey=shot.survey.of(agents)), agents


def ways_of(thresholds: Bill) -> tuple[Way, ...]:
    """Return the ways to LODs that share meshes as far as these matter."""
    return (share_meshes, switch_together) if thresholds.meshes_matter else (pay_alone,)


def solved(shot: Shot, thresholds: Bill, weight: float) -> Generator[float, None, Solution]:
    """Return the solution of least cost that is found for one weight of switches."""
    ways = ways_of(thresholds)
    work = Workload(len(ways))
    found = []
    for way in ways:
        found.append((yield from work.take(way(shot, thresholds, weight), 1)))
    return min(found, key=lambda solution: objective(solution.bill, weight))


def pay_alone(shot: Shot, thresholds: Bill, weight: float) -> Generator[float, None, Solution]:
    """Let each agent pay its share of a mesh, as if all that may show it did."""
    table = _table(shot, thresholds.mesh_shares)
    levels, shared = yield from decided(shot, table, weight)
    is_bound = not thresholds.meshes_matter and "traced" not in shot.costs.seconds
    return Solution(Bill(shot, levels), weight, shared if is_bound else None)


def share_meshes(shot: Shot, thresholds: Bill, weight: float) -> Generator[float, None, Solution]:
    """Let agents pay next to nothing for meshes that others show anyway.

    In a first round each pays its share. In the second the meshes of the first cost next to
    nothing, and all others their whole price.
    """
    work = Workload(2)
    first = yield from work.take(pay_alone(shot, thresholds, weight), 1)
    table = shared_table(shot, thresholds, first.bill)
    levels, _ = yield from work.take(decided(shot, table, weight), 1)
    return Solution(Bill(shot, levels), weight)


def switch_together(
    shot: Shot, thresholds: Bill, weight: float
) -> Generator[float, None, Solution]:
    """Let all agents of a character show one LOD in a frame."""
    yield 0.0
    levels = by_character(shot, thresholds.mesh_seconds, weight)
    return Solution(Bill(shot, levels), weight)


def shared_table(shot: Shot, thresholds: Bill, plan_bill: Bill) -> np.ndarray:
    """Return (F, K, L) float32 seconds of an agent if meshes that `plan_bill` shows cost next to
    nothing.
    """
    is_shown = plan_bill.agents_shown > 0
    shares = NEARLY * thresholds.mesh_shares
    return _table(shot, np.where(is_shown, shares, thresholds.mesh_seconds))


def _table(shot: Shot, unique: np.ndarray) -> np.ndarray:
    return (shot.instance + unique).astype(np.float32)


def lower_bound(
    shot: Shot, weight: float, shared: float | None = None
) -> Generator[float, None, float]:
    """Return seconds that no plan of the shot can go below, switches counted by `weight`.

    shared: the least sum of agents that share meshes evenly, where it is known.
    """
    fixed, least, table = _floor(shot)
    if shared is None:
        _, shared = yield from decided(shot, table, weight)
    return fixed + max(least, shared)


def _floor(shot: Shot) -> tuple[float, float, np.ndarray]:
    """Return (fixed, least, table (F, K, L) float32), all in seconds, which bound every plan from
    below.

    A plan costs `fixed` and, besides, no less than `least`, nor than a program by the table.
    Each frame shows of each character a LOD as fine as the finest that one of its agents needs, at
    least. And if all agents share a mesh's cost evenly, they pay no more than it costs, so that the
    least sum of their own costs is none that a plan can go below.
    """
    survey = shot.survey
    characters = len(shot.survey.owner)
    frames = len(survey.times)
    triangles = shot.meshes.triangles.T[:, survey.owner]
    agents = shot.least_shown
    seen_agents = agents.sum(axis=1)
    finest = (agents > 0).argmax(axis=1)
    least = np.where(seen_agents > 0, triangles[finest, np.arange(characters)], 0.0)
    unique = shot.costs.seconds["unique"] * triangles / np.maximum(seen_agents, 1)[:, None, :]
    work = cost_model.Work(
        posed=float(least.max(axis=0).sum()),
        unique=least.sum(axis=1),
        instances=seen_agents.sum(axis=1).astype(np.float64),
        instanced=(agents * triangles).sum(axis=(1, 2)),
        rigs=work_in(shot, agents).rigs,
        rays=survey.rays,
    )
    alone = replace(work, posed=0.0, rigs=0.0, rays=0.0)
    whole, parts = (frames * cost_model.price(own, shot.costs).seconds for own in (work, alone))
    return whole - parts, parts, _table(shot, unique)
