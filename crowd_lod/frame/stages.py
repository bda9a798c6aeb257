"""Culling, LODs and sorting of one frame: blocks of agents first, then each agent left open."""

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..crowd.agents import Crowd
from ..culling.blocks import CULLED, OPEN, Blocks, Look, decide
from ..culling.camera import Camera
from ..culling.radar import RadarOptions, lost, radar
from ..levels.assignment import Bias, LevelPolicy, assign
from ..sorting.buckets import Buckets, count_groups, sort, sort_blocks
from ..sources.trajectory import Trajectory
from .index_cache import blocks_at, displacement_of


@dataclass(frozen=True, kw_only=True)
class Request:
    """The input of one frame's plan, besides the crowd.

    time: in frames; LODs are those of this time.
    eyes: one camera, or the eyes of a stereo picture.
    policy: how LODs follow from distance.
    shutter: with motion blur, (time in frames, the eyes' cameras from shutter.open_shutter) at each
        sample of the open shutter, in order. An agent seen at any of them is visible. With a fixed
        margin nothing is grown for the shutter except by the cameras' motion.
    bias: the painted detail map.
    """

    time: float
    eyes: tuple[Camera, ...]
    policy: LevelPolicy
    shutter: tuple[tuple[float, Sequence[Camera]], ...] = ()
    bias: Bias | None = None


@dataclass(frozen=True)
class Moment:
    """A time at which agents may be seen.

    time: in frames.
    eyes: the cameras at that time.
    radius: (G,) float64 meters, of the groups' spheres, which hold what is drawn until the next
        moment.
    """

    time: float
    eyes: Sequence[Camera]
    radius: np.ndarray


def moments(trajectory: Trajectory, request: Request) -> list[Moment]:
    """Return the times at which agents may be seen; LODs are those of the first."""
    reach = trajectory.spheres.reach
    grown = reach + trajectory.most_moved([time for time, _ in request.shutter])
    return [
        Moment(request.time, request.eyes, reach),
        *(Moment(time, eyes, grown) for time, eyes in request.shutter),
    ]


@dataclass(frozen=True)
class Task:
    """The input of the three stages.

    crowd: at the request's time.
    moments: the moments, with the grain of pictures.
    thresholds: (G, n - 1) meters, where LODs begin.
    ticks: the clock's seconds at the ends of the stages so far; whoever does a stage adds its own.
    """

    trajectory: Trajectory
    request: Request
    crowd: Crowd
    moments: list[Moment]
    thresholds: np.ndarray
    ticks: list[float]

    def factors(self, agents: np.ndarray | slice = slice(None)) -> np.ndarray | None:
        """Return the bias of the distance of `agents`, (m,) float64, or None."""
        bias = self.request.bias
        return None if bias is None else bias.at(self.crowd.x[agents], self.crowd.y[agents])


@dataclass(frozen=True)
class Sorted:
    """The result of a task.

    dropped: agents at NaN or infinity.
    in_blocks: whether blocks of agents were decided at once.
    counted: from `tally`, if it is at hand.
    levels: (n,) uint8, of all agents, if they are at hand.
    """

    buckets: Buckets
    dropped: int
    in_blocks: bool
    counted: tuple[np.ndarray, np.ndarray] | None = None
    levels: np.ndarray | None = None


def sorted_by_level(task: Task) -> Sorted:
    """Return the visible agents by LOD."""
    dated_blocks = blocks_at(task.trajectory, task.request.time)
    return _one_by_one(task) if dated_blocks is None else _by_blocks(task, *dated_blocks)


def _one_by_one(task: Task) -> Sorted:
    """Test every agent."""
    dropped = len(lost(task.crowd))
    visible, distance = _radar(task)
    task.ticks.append(clock.perf_counter())
    levels = assign(distance, task.thresholds, task.crowd.group, task.factors())
    task.ticks.append(clock.perf_counter())
    buckets = sort(visible, levels, task.request.policy.count)
    task.ticks.append(clock.perf_counter())
    return Sorted(buckets, dropped, False, levels=levels)


def _by_blocks(task: Task, since: int, blocks: Blocks) -> Sorted:
    """Decide blocks at once (culling/blocks.py), then test the agents of those left open.

    since: the frame when the blocks were made.
    """
    group = task.crowd.group
    dropped = 0 if blocks.finite else len(lost(task.crowd))
    decided = _decide_blocks(task, since, blocks)
    agents = blocks.agents((decided == OPEN).nonzero()[0])
    visible, distance = _radar(task, agents)
    task.ticks.append(clock.perf_counter())
    levels = np.full(len(agents), CULLED, np.uint8)
    seen = agents[visible]
    levels[visible] = assign(distance[visible], task.thresholds, group[seen], task.factors(seen))
    task.ticks.append(clock.perf_counter())
    buckets = sort_blocks(blocks, decided, levels, task.request.policy.count)
    groups = len(task.trajectory.groups)
    present = [count_groups(group, buckets[level], groups) for level in range(len(buckets.counts))]
    counted = np.array(present), count_groups(group, blocks.order, groups)
    task.ticks.append(clock.perf_counter())
    return Sorted(buckets, dropped, True, counted)


def _decide_blocks(task: Task, since: int, blocks: Blocks) -> np.ndarray:
    """Return the LOD of each block, made at frame `since`, or CULLED, or OPEN, (b,) uint8."""
    radius = task.moments[0].radius
    views = [
        [
            Look(
                camera,
                *displacement_of(task.trajectory, moment.time, since),
                float((moment.radius - radius).max()),
            )
            for camera in moment.eyes
        ]
        for moment in task.moments
    ]
    thresholds = task.thresholds if task.request.bias is None else None
    return decide(blocks, views, thresholds, task.request.policy.margin)


def _radar(task: Task, agents: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return (visible, distance) of `agents` (m,), or of all: seen at any of the moments.

    Distances are those of the first moment.
    """
    trajectory = task.trajectory
    policy = task.request.policy
    center = trajectory.spheres.center
    now, *shutter = task.moments
    options = RadarOptions(policy.margin)
    visible, distance = radar(task.crowd, now.eyes, center, now.radius, options, agents)
    unmeasured = replace(options, measure=False)
    for moment in shutter:
        crowd = trajectory.at(moment.time)
        visible |= radar(crowd, moment.eyes, center, moment.radius, unmeasured, agents)[0]
    return visible, distance
