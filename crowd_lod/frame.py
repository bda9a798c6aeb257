"""One frame's plan: behaviour > culling > levels > sorting."""

import operator
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .agents import Crowd, Group
from .behaviour import Trajectory
from .camera import Camera
from .culling import Bounds, bounds, lost, radar, refuse_lost
from .lean import ALL_INSIDE, ALL_OUTSIDE, ITEMS, ONE_BUCKET, ONE_LEVEL, STATIC, STILL, LeftOut
from .levels import Bias, LevelPolicy, assign, limits
from .sorting import Buckets, sort


@dataclass(frozen=True)
class Frame:
    """What one frame shows.

    time: in frames. visible: (n,) bool. levels: (n,) uint8, the LOD of every agent, also of those culled. begins:
    (G, n - 1) metres, where each group's LODs 1 ... n - 1 begin (levels.limits). vertices,
    triangles: to be drawn for the visible agents; full_vertices, full_triangles: without culling and LOD.
    milliseconds: of each stage, in the order of the pipeline. camera: the first where there are several. dropped: agents
    left out because they stand at NaN or infinity. left_out: what the scene did not need, in the order of the pipeline;
    like the milliseconds it tells how this plan was made, and all else is the same without it. shadow, mirrored: agents that
    are not visible but cast shadows into the picture, or are seen in mirrors; None if not looked for (shadows.py).
    """

    time: float
    crowd: Crowd
    camera: Camera
    visible: np.ndarray
    levels: np.ndarray
    buckets: Buckets
    begins: np.ndarray
    vertices: int
    triangles: int
    full_vertices: int
    full_triangles: int
    milliseconds: dict[str, float]
    dropped: int = 0
    left_out: tuple[LeftOut, ...] = ()
    shadow: Buckets | None = None
    mirrored: Buckets | None = None


def plan(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: float,
    shutter: Sequence[tuple[float, Sequence[Camera]]] = (),
    bias: Bias | None = None,
    lean: bool = True,
) -> Frame:
    """The plan of the frame at `time`: a pure function of its arguments, whichever frame came before.

    camera: one, or the eyes of a stereo picture. shutter: with motion blur, (time in frames, the eyes' cameras from
    camera.opened) at each sample of the open shutter, in order: what is seen at any of them is visible. LODs are those
    of `time`. With a fixed margin nothing is grown for it but what the cameras move. bias: painted layer. lean: leave out
    what the scene does not need.
    """
    trajectory = trajectory if lean else trajectory.full
    leave, left = trajectory.leave, set(trajectory.left_out)
    groups = trajectory.groups
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    centre = np.array([g.centre for g in groups])
    radius = np.array([g.radius for g in groups])
    ticks = [clock.perf_counter()]
    crowd = trajectory.at(time)
    ticks.append(clock.perf_counter())
    grown = radius + most_moved(trajectory, [sample for sample, _ in shutter])
    asked = None
    if STATIC in leave and STILL in left:
        crowds = [crowd, *(trajectory.at(sample) for sample, _ in shutter)]
        painted = None if bias is None else (bias.values.tobytes(), bias.area)
        views = [_values(each) for each in (cameras, *(eyes for _, eyes in shutter))]
        asked = [column for each in crowds for column in (each.x, each.y, each.z, each.group)], (
            views, policy, painted, grown.tobytes()
        )  # fmt: skip
        made = trajectory.memo
        if made is not None and made[1] == asked[1] and all(map(operator.is_, made[0], asked[0])):
            ticks += [clock.perf_counter()] * 3
            left_out = STATIC, *made[2].left_out
            return replace(
                made[2], time=time, crowd=crowd, camera=cameras[0], milliseconds=_milliseconds(ticks), left_out=left_out
            )
    about = (centre, radius, policy.margin, policy.metric == "RADIAL", trajectory.left_out)
    box = bounds(crowd, cameras, *about) if leave else Bounds()
    gone = lost(crowd) if not box.finite else ()
    if not policy.drop_lost:
        refuse_lost(gone, len(crowd))
    begin = limits(policy, cameras[0], radius, deviations(groups, policy.count))
    level = _one_level(begin, box, bias) if ONE_LEVEL in leave else None
    every = box.every if (ALL_INSIDE if box.every else ALL_OUTSIDE) in leave else None
    visible, distance = radar(crowd, cameras, *about, every, measure=level is None)
    for sample, eyes in shutter:
        if every:
            break
        moved, about = trajectory.at(sample), (centre, grown, policy.margin, False, trajectory.left_out)
        seen = bounds(moved, eyes, *about).every if {ALL_INSIDE, ALL_OUTSIDE} <= leave else None
        visible |= radar(moved, eyes, *about, seen, measure=False)[0]
        every = seen if seen or every is False else None
    ticks.append(clock.perf_counter())
    if level is None:
        factor = None if bias is None else bias.at(crowd.x, crowd.y)
        levels = assign(distance, begin, crowd.group, factor)
    else:
        levels = np.full(len(crowd), level, np.uint8)
        left.add(ONE_LEVEL)
    ticks.append(clock.perf_counter())
    buckets = sort(visible, levels, policy.count, ONE_BUCKET in leave)
    ticks.append(clock.perf_counter())
    if every is not None:
        left.add(ALL_INSIDE if every else ALL_OUTSIDE)
    if ONE_BUCKET in leave and np.count_nonzero(buckets.counts) <= 1:
        left.add(ONE_BUCKET)
    vertices, full_vertices = cost(crowd, buckets, [g.vertices for g in groups])
    triangles, full_triangles = cost(crowd, buckets, [g.triangles for g in groups])
    frame = Frame(
        time=time,
        crowd=crowd,
        camera=cameras[0],
        visible=visible,
        levels=levels,
        buckets=buckets,
        begins=begin,
        vertices=vertices,
        triangles=triangles,
        full_vertices=full_vertices,
        full_triangles=full_triangles,
        milliseconds=_milliseconds(ticks),
        dropped=len(gone),
        left_out=tuple(item for item in ITEMS if item in left),
    )
    trajectory.memo = None if asked is None else (*asked, frame)
    return frame


def _milliseconds(ticks: list[float]) -> dict[str, float]:
    stages = ("behaviour", "culling", "levels", "sorting")
    return {name: 1000 * float(b - a) for name, a, b in zip(stages, ticks[:-1], ticks[1:], strict=True)}


def _values(cameras: Sequence[Camera]) -> list[tuple]:
    """What the cameras are, to be compared."""
    return [tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(camera).values()) for camera in cameras]


def _one_level(begin: np.ndarray, box: Bounds, bias: Bias | None) -> int | None:
    """The LOD of every agent, if its distance, within the bounds, leaves no choice. begin: (G, n - 1), from `limits`."""
    if begin.shape[1] == 0:
        return 0
    if bias is not None:
        return None
    finest, coarsest = (assign(np.full(len(begin), d), begin, np.arange(len(begin))) for d in (box.nearest, box.farthest))
    return int(finest[0]) if (np.append(finest, coarsest) == finest[0]).all() else None


def most_moved(trajectory: Trajectory, times: Sequence[float]) -> float:
    """Metres that an agent may walk between two of the `times`, in frames: the whole gap's, not half of it, so that one
    which jumps to the other side of a wrapping map is covered before and after."""
    gap = max(np.diff(times), default=0.0)
    return float(np.linalg.norm(trajectory.machine.velocity, axis=-1).max()) * gap * trajectory.seconds_per_frame


def deviations(groups: Sequence[Group], count: int) -> np.ndarray | None:
    """(G, count) float64 metres: the measured deviation of each group's LODs; None while one is not measured."""
    if not all(len(group.deviations) >= count for group in groups):
        return None
    return np.array([group.deviations[:count] for group in groups], np.float64)


def cost(crowd: Crowd, buckets: Buckets, sizes: list[tuple[int, ...]]) -> tuple[int, int]:
    """(drawn, full): the sum of `sizes` (of each group: one a LOD, or none if not known) over buckets, over all agents."""
    if not all(len(each) >= len(buckets.counts) for each in sizes):
        return 0, 0
    full = np.bincount(crowd.group, minlength=len(sizes))
    drawn = 0
    for level in range(len(buckets.counts)):
        present = np.bincount(crowd.group[buckets[level]], minlength=len(sizes))
        drawn += sum(int(n) * each[level] for n, each in zip(present, sizes, strict=True))
    return drawn, sum(int(n) * each[0] for n, each in zip(full, sizes, strict=True))
