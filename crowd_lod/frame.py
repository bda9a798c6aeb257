"""One frame's plan: behaviour > culling > levels > sorting."""

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .agents import Crowd
from .behaviour import Trajectory
from .camera import Camera
from .culling import lost, radar, refuse_lost
from .levels import Bias, LevelPolicy, assign, limits
from .sorting import Buckets, sort


@dataclass(frozen=True)
class Frame:
    """What one frame shows.

    time: in frames. visible: (n,) bool. levels: (n,) uint8, the LOD of every agent, also of those culled. vertices,
    triangles: to be drawn for the visible agents; full_vertices, full_triangles: without culling and LOD.
    milliseconds: of each stage, in the order of the pipeline. camera: the first where there are several. dropped: agents
    left out because they stand at NaN or infinity.
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
    dropped: int = 0


def plan(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: float,
    shutter: Sequence[tuple[float, Sequence[Camera]]] = (),
    bias: Bias | None = None,
    deviation: np.ndarray | None = None,
) -> Frame:
    """The plan of the frame at `time`: a pure function of its arguments, whichever frame came before.

    camera: one, or the eyes of a stereo picture. shutter: with motion blur, (time in frames, the eyes' cameras from
    camera.opened) at each sample of the open shutter, in order: what is seen at any of them is visible. LODs are those
    of `time`. With a fixed margin nothing is grown for it but what the cameras move. bias: painted layer. deviation: (G, n) metres, for a tolerance.
    """
    groups = trajectory.groups
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    centre = np.array([g.centre for g in groups])
    radius = np.array([g.radius for g in groups])
    ticks = [clock.perf_counter()]
    crowd = trajectory.at(time)
    ticks.append(clock.perf_counter())
    gone = lost(crowd)
    if not policy.drop_lost:
        refuse_lost(gone, len(crowd))
    visible, distance = radar(crowd, cameras, centre, radius, policy.margin, policy.metric == "RADIAL")
    reach = radius + _most_moved(trajectory, [sample for sample, _ in shutter])
    for sample, eyes in shutter:
        visible |= radar(trajectory.at(sample), eyes, centre, reach, policy.margin)[0]
    ticks.append(clock.perf_counter())
    factor = None if bias is None else bias.at(crowd.x, crowd.y)
    levels = assign(distance, limits(policy, cameras[0], radius, deviation), crowd.group, factor)
    ticks.append(clock.perf_counter())
    buckets = sort(visible, levels, policy.count)
    ticks.append(clock.perf_counter())
    stages = ("behaviour", "culling", "levels", "sorting")
    vertices, full_vertices = _cost(crowd, buckets, [g.vertices for g in groups])
    triangles, full_triangles = _cost(crowd, buckets, [g.triangles for g in groups])
    return Frame(
        time=time,
        crowd=crowd,
        camera=cameras[0],
        visible=visible,
        levels=levels,
        buckets=buckets,
        vertices=vertices,
        triangles=triangles,
        full_vertices=full_vertices,
        full_triangles=full_triangles,
        milliseconds={name: 1000 * float(b - a) for name, a, b in zip(stages, ticks[:-1], ticks[1:], strict=True)},
        dropped=len(gone),
    )


def _most_moved(trajectory: Trajectory, times: Sequence[float]) -> float:
    """Metres that an agent may walk between two of the `times`, in frames: the whole gap's, not half of it, so that one
    which jumps to the other side of a wrapping map is covered before and after."""
    gap = max(np.diff(times), default=0.0)
    return float(np.linalg.norm(trajectory.machine.velocity, axis=-1).max()) * gap * trajectory.seconds_per_frame


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
