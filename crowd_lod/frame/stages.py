"""Culling, LODs and sorting of one frame, in one of three ways that find the same.

They go by every agent, by blocks of agents, or are made elsewhere.
"""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import ALL_INSIDE, ALL_OUTSIDE, BLOCKS, IN_ORDER, NOTHING, ONE_BUCKET, ONE_LEVEL, LeftOut
from ..culling.blocks import CULLED, LEAF, Blocks, decide
from ..culling.camera import Camera
from ..culling.frustum_box_test import Look
from ..culling.radar import Bounds, RadarOptions, bounds, lost, radar, refuse_lost
from ..levels.assignment import Bias, LevelPolicy, assign
from ..sorting.buckets import Buckets, sort, sort_blocks, sort_in_order
from ..sources.trajectory import Trajectory
from .index_cache import blocks_at, moved
from .request import Moment, Request


@dataclass(frozen=True)
class Unsorted:
    """What a `Sorter` is asked with.

    order: (n,) int32, agent indices; None for agent order.
    begins: (G, n - 1) meters, where LODs begin.
    """

    crowd: Crowd
    order: np.ndarray | None
    camera: Camera
    policy: LevelPolicy
    begins: np.ndarray


# Another way to cull, give LODs and sort, of the same agents and LODs. It returns (places (m,)
# int32, offsets (n + 1,) intp): where in the order the visible agents of LOD k stand is
# places[offsets[k]:offsets[k + 1]], rising. See operators/overlay/gpu_culling.py.
Sorter = Callable[[Unsorted], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Task:
    """What is to be culled, given LODs and sorted.

    crowd: at the request's time.
    seen: the moments, with the grain of pictures.
    begins: (G, n - 1) meters, where LODs begin.
    ticks: the clock's seconds at the ends of the stages so far; whoever does a stage adds its own.
    """

    trajectory: Trajectory
    request: Request
    crowd: Crowd
    seen: list[Moment]
    begins: np.ndarray
    ticks: list[float]

    def factors(self, agents: np.ndarray | slice = slice(None)) -> np.ndarray | None:
        """Return the bias of the distance of `agents`, (m,) float64, or None."""
        bias = self.request.bias
        return None if bias is None else bias.at(self.crowd.x[agents], self.crowd.y[agents])

    def lost(self) -> int:
        """Return how many agents are dropped at NaN or infinity.

        Raises CrowdError if the policy does not allow any.
        """
        gone = lost(self.crowd)
        if not self.request.policy.drop_lost:
            refuse_lost(gone, len(self.crowd))
        return len(gone)


@dataclass(frozen=True)
class Sorted:
    """What was found for a task.

    dropped: agents at NaN or infinity.
    left_out: what was not needed.
    counted: from `tally`, if it is at hand.
    levels: (n,) uint8, of all agents, if they are at hand.
    """

    buckets: Buckets
    dropped: int
    left_out: frozenset[LeftOut]
    counted: tuple[np.ndarray, np.ndarray] | None = None
    levels: np.ndarray | None = None


def sorted_by_level(task: Task, sorter: Sorter | None) -> Sorted:
    """Return the visible agents by LOD, found in the way that suits the task.

    sorter: finds them if there is one camera, no panorama, and no shutter, bias or lens blur.
    """
    trajectory, made = task.trajectory, blocks_at(task.trajectory, task.request.time)
    eyes, bias = task.request.eyes, task.request.bias
    if sorter is not None and len(task.seen) == len(eyes) == 1 and bias is None and not eyes[0].turn and eyes[0].kind != "PANO":
        return _elsewhere(task, made and made[1], sorter)
    if made is not None and BLOCKS in trajectory.leave & trajectory.left_out:
        return _by_blocks(task, *made)
    return _one_by_one(task, made and made[1])


def _one_by_one(task: Task, blocks: Blocks | None) -> Sorted:
    """Test every agent.

    blocks: those of the crowd, for their order.
    """
    trajectory, crowd, policy, bias = task.trajectory, task.crowd, task.request.policy, task.request.bias
    leave, center = trajectory.leave, trajectory.spheres.center
    items: set[LeftOut] = set()
    now, *shutter = task.seen
    options = RadarOptions(policy.margin, policy.metric == "RADIAL", trajectory.left_out)
    box = bounds(crowd, now.eyes, center, now.radius, options) if leave else Bounds()
    gone = 0 if box.finite else task.lost()
    level = _one_level(task.begins, box, bias) if ONE_LEVEL in leave else None
    every = box.every if (ALL_INSIDE if box.every else ALL_OUTSIDE) in leave else None
    visible, distance = radar(crowd, now.eyes, center, now.radius, replace(options, every=every, measure=level is None))
    unmeasured = replace(options, radial=False, measure=False)
    for moment in shutter:
        if every:
            break
        about = trajectory.at(moment.time), moment.eyes, center, moment.radius
        seen = bounds(*about, unmeasured).every if {ALL_INSIDE, ALL_OUTSIDE} <= leave else None
        visible |= radar(*about, replace(unmeasured, every=seen))[0]
        every = seen if seen or every is False else None
    task.ticks.append(clock.perf_counter())
    if level is None:
        levels = assign(distance, task.begins, crowd.group, task.factors())
    else:
        levels = np.full(len(crowd), level, np.uint8)
        items.add(ONE_LEVEL)
    task.ticks.append(clock.perf_counter())
    if blocks is None:
        buckets = sort(visible, levels, policy.count, ONE_BUCKET in leave)
    else:
        shown = np.where(visible, levels, CULLED)
        buckets = sort_in_order(shown[blocks.order], blocks.order, policy.count)
    task.ticks.append(clock.perf_counter())
    if every is not None:
        items.add(ALL_INSIDE if every else ALL_OUTSIDE)
    return Sorted(buckets, gone, (trajectory.left_out - {BLOCKS}) | items, levels=levels)


def _by_blocks(task: Task, since: int, blocks: Blocks) -> Sorted:
    """Do the same as `_one_by_one` with blocks decided at once (culling/blocks.py).

    since: the frame when the blocks were made.
    """
    trajectory, crowd, policy, begins = task.trajectory, task.crowd, task.request.policy, task.begins
    now, *shutter = task.seen
    radius, radial = now.radius, policy.metric == "RADIAL"
    gone = 0 if blocks.finite else task.lost()
    looks = [
        [Look(camera, *moved(trajectory, moment.time, since), float((moment.radius - radius).max())) for camera in moment.eyes]
        for moment in task.seen
    ]
    decided, places = decide(blocks, crowd, looks, begins if task.request.bias is None else None, policy.margin, radial)
    agents = blocks.rows[decided.opened[places // LEAF], places % LEAF]
    center, options = trajectory.spheres.center, RadarOptions(policy.margin, radial, trajectory.left_out | {IN_ORDER})
    visible, distance = radar(crowd, now.eyes, center, radius, options, agents)
    unmeasured = replace(options, radial=False, measure=False)
    for moment in shutter:
        visible |= radar(trajectory.at(moment.time), moment.eyes, center, moment.radius, unmeasured, agents)[0]
    task.ticks.append(clock.perf_counter())
    seen = agents[visible]
    decided.own.reshape(-1)[places[visible]] = assign(distance[visible], begins, crowd.group[seen], task.factors(seen))
    task.ticks.append(clock.perf_counter())
    buckets, present = sort_blocks(blocks, decided, crowd.group, policy.count)
    task.ticks.append(clock.perf_counter())
    holds = {ALL_INSIDE: len(buckets.order) == len(crowd), ALL_OUTSIDE: not len(buckets.order)}
    holds[ONE_LEVEL] = task.request.bias is None and bool(np.count_nonzero(buckets.counts) <= 1)
    known = trajectory.leave if not len(places) else NOTHING
    items = {item for item in known if holds.get(item)}
    return Sorted(buckets, gone, trajectory.left_out | items, (present, np.diff(blocks.groups)))


def _elsewhere(task: Task, blocks: Blocks | None, sorter: Sorter) -> Sorted:
    """Do the same as `_one_by_one` by `sorter`; all of its time counts as culling."""
    crowd = task.crowd
    gone = 0 if blocks is not None and blocks.finite else task.lost()
    order = None if blocks is None else blocks.order
    places, offsets = sorter(Unsorted(crowd, order, task.seen[0].eyes[0], task.request.policy, task.begins))
    counted = None
    if blocks is not None:
        edges = [np.searchsorted(places[a:b], blocks.groups) for a, b in zip(offsets[:-1], offsets[1:], strict=True)]
        counted = np.diff(edges, axis=1), np.diff(blocks.groups)
    buckets = Buckets(places if order is None else order[places], offsets)
    task.ticks.extend([clock.perf_counter()] * 3)
    left = frozenset(item for item in task.trajectory.left_out if item.stage != "culling")
    return Sorted(buckets, gone, left, counted)


def _one_level(begin: np.ndarray, box: Bounds, bias: Bias | None) -> int | None:
    """Return the LOD of all agents if their distances allow only one, else None.

    begin: (G, n - 1), from `limits`.
    """
    if begin.shape[1] == 0:
        return 0
    if bias is not None:
        return None
    finest, coarsest = (assign(np.full(len(begin), d), begin, np.arange(len(begin))) for d in (box.nearest, box.farthest))
    return int(finest[0]) if (np.append(finest, coarsest) == finest[0]).all() else None
