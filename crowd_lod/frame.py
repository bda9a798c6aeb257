"""One frame's plan: behaviour > culling > levels > sorting."""

import time as clock
from dataclasses import dataclass

import numpy as np

from .agents import Crowd
from .behaviour import Trajectory
from .camera import Camera
from .culling import radar
from .levels import LevelPolicy, assign
from .sorting import Buckets, sort


@dataclass(frozen=True)
class Frame:
    """What one frame shows.

    time: in frames. visible: (n,) bool. levels: (n,) uint8, the LOD of every agent, also of those culled. vertices,
    triangles: to be drawn for the visible agents; full_vertices, full_triangles: without culling and LOD.
    milliseconds: of each stage, in the order of the pipeline.
    """

    time: float
    crowd: Crowd
    camera: Camera
    visible: np.ndarray
    levels: np.ndarray
    buckets: Buckets
    vertices: int
    triangles: int
    full_vertices: int
    full_triangles: int
    milliseconds: dict[str, float]


def plan(trajectory: Trajectory, camera: Camera, policy: LevelPolicy, time: float) -> Frame:
    """The plan of the frame at `time`: a pure function of its arguments, whichever frame came before."""
    groups = trajectory.groups
    centre = np.array([g.centre for g in groups])
    radius = np.array([g.radius for g in groups])
    ticks = [clock.perf_counter()]
    crowd = trajectory.at(time)
    ticks.append(clock.perf_counter())
    visible, distance = radar(crowd, camera, centre, radius, policy.margin, policy.metric == "RADIAL")
    ticks.append(clock.perf_counter())
    levels = assign(distance, camera.far, policy.thresholds)
    ticks.append(clock.perf_counter())
    buckets = sort(visible, levels, policy.count)
    ticks.append(clock.perf_counter())
    stages = ("behaviour", "culling", "levels", "sorting")
    vertices, full_vertices = _cost(crowd, buckets, [g.vertices for g in groups])
    triangles, full_triangles = _cost(crowd, buckets, [g.triangles for g in groups])
    return Frame(
        time=time,
        crowd=crowd,
        camera=camera,
        visible=visible,
        levels=levels,
        buckets=buckets,
        vertices=vertices,
        triangles=triangles,
        full_vertices=full_vertices,
        full_triangles=full_triangles,
        milliseconds={name: 1000 * float(b - a) for name, a, b in zip(stages, ticks[:-1], ticks[1:], strict=True)},
    )


def _cost(crowd: Crowd, buckets: Buckets, sizes: list[tuple[int, ...]]) -> tuple[int, int]:
    """(drawn, full): the sum of `sizes` (of each group: one a LOD, or none if not known) over buckets, over all agents."""
    if not all(len(each) >= len(buckets.counts) for each in sizes):
        return 0, 0
    full = np.bincount(crowd.group, minlength=len(sizes))
    drawn = 0
    for level in range(len(buckets.counts)):
        present = np.bincount(crowd.group[buckets[level]], minlength=len(sizes))
        drawn += sum(int(n) * each[level] for n, each in zip(present, sizes, strict=True))
    return drawn, sum(int(n) * each[0] for n, each in zip(full, sizes, strict=True))
