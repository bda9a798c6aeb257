"""Culling, LODs and sorting of one frame, in one of three ways that find the same.

They go by every agent, by blocks of agents, or are made elsewhere.
"""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import BLOCKS, LeftOut
from ..culling.blocks import CULLED, LEAF, Blocks, decide
from ..culling.camera import Camera
from ..culling.frustum_box_test import Look
from ..culling.radar import RadarOptions, lost, radar, refuse_lost
from ..levels.assignment import LevelPolicy, assign
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
    trajectory = task.trajectory
    made = blocks_at(task.trajectory, task.request.time)
    eyes = task.request.eyes
    bias = task.request.bias
    if (
        sorter is not None
        and len(task.seen) == len(eyes) == 1
        and bias is None
        and not eyes[0].turn
        and eyes[0].kind != "PANO"
    ):
        return _elsewhere(task, made and made[1], sorter)
    if made is not None and BLOCKS in trajectory.leave & trajectory.left_out:
        return _by_blocks(task, *made)
    return _one_by_one(task, made and made[1])


def _one_by_one(task: Task, blocks: Blocks | None) -> Sorted:
    """Test every agent.

    blocks: those of the crowd, for their order.
    """
    trajectory = task.trajectory
    crowd = task.crowd
    policy = task.request.policy
    center = trajectory.spheres.center
    now, *shutter = task.seen
    gone = task.lost()
    options = RadarOptions(policy.margin, policy.metric == "RADIAL")
    visible, distance = radar(crowd, now.eyes, center, now.radius, options)
    unmeasured = replace(options, radial=False, measure=False)
    for moment in shutter:
        visible |= radar(
            trajectory.at(moment.time), moment.eyes, center, moment.radius, unmeasured
        )[0]
    task.ticks.append(clock.perf_counter())
    levels = assign(distance, task.begins, crowd.group, task.factors())
    task.ticks.append(clock.perf_counter())
    if blocks is None:
        buckets = sort(visible, levels, policy.count)
    else:
        shown = np.where(visible, levels, CULLED)
        buckets = sort_in_order(shown[blocks.order], blocks.order, policy.count)
    task.ticks.append(clock.perf_counter())
    return Sorted(buckets, gone, trajectory.left_out - {BLOCKS}, levels=levels)


def _by_blocks(task: Task, since: int, blocks: Blocks) -> Sorted:
    """Do the same as `_one_by_one` with blocks decided at once (culling/blocks.py).

    since: the frame when the blocks were made.
    """
    trajectory = task.trajectory
    crowd = task.crowd
    policy = task.request.policy
    begins = task.begins
    now, *shutter = task.seen
    radius = now.radius
    radial = policy.metric == "RADIAL"
    gone = 0 if blocks.finite else task.lost()
    looks = [
        [
            Look(
                camera,
                *moved(trajectory, moment.time, since),
                float((moment.radius - radius).max()),
            )
            for camera in moment.eyes
        ]
        for moment in task.seen
    ]
    decided, places = decide(
        blocks, crowd, looks, begins if task.request.bias is None else None, policy.margin, radial
    )
    agents = blocks.rows[decided.opened[places // LEAF], places % LEAF]
    center = trajectory.spheres.center
    options = RadarOptions(policy.margin, radial)
    visible, distance = radar(crowd, now.eyes, center, radius, options, agents)
    unmeasured = replace(options, radial=False, measure=False)
    for moment in shutter:
        visible |= radar(
            trajectory.at(moment.time), moment.eyes, center, moment.radius, unmeasured, agents
        )[0]
    task.ticks.append(clock.perf_counter())
    seen = agents[visible]
    decided.own.reshape(-1)[places[visible]] = assign(
        distance[visible], begins, crowd.group[seen], task.factors(seen)
    )
    task.ticks.append(clock.perf_counter())
    buckets, present = sort_blocks(blocks, decided, crowd.group, policy.count)
    task.ticks.append(clock.perf_counter())
    return Sorted(buckets, gone, trajectory.left_out, (present, np.diff(blocks.groups)))


def _elsewhere(task: Task, blocks: Blocks | None, sorter: Sorter) -> Sorted:
    """Do the same as `_one_by_one` by `sorter`; all of its time counts as culling."""
    crowd = task.crowd
    gone = 0 if blocks is not None and blocks.finite else task.lost()
    order = None if blocks is None else blocks.order
    places, offsets = sorter(
        Unsorted(crowd, order, task.seen[0].eyes[0], task.request.policy, task.begins)
    )
    counted = None
    if blocks is not None:
        edges = [
            np.searchsorted(places[a:b], blocks.groups)
            for a, b in zip(offsets[:-1], offsets[1:], strict=True)
        ]
        counted = np.diff(edges, axis=1), np.diff(blocks.groups)
    buckets = Buckets(places if order is None else order[places], offsets)
    task.ticks.extend([clock.perf_counter()] * 3)
    left = frozenset(item for item in task.trajectory.left_out if item.stage != "culling")
    return Sorted(buckets, gone, left, counted)
