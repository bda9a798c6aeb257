"""One frame's plan: behavior > culling > levels > sorting."""

import operator
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..behaviour.trajectory import Trajectory
from ..crowd.agents import Crowd
from ..crowd.leave_outs import (
    ALL_INSIDE,
    ALL_OUTSIDE,
    BLOCKS,
    IN_ORDER,
    ITEMS,
    NOTHING,
    ONE_BUCKET,
    ONE_LEVEL,
    STATIC,
    STILL,
    LeftOut,
)
from ..culling.blocks import CULLED, LEAF, decide
from ..culling.camera import Camera, pictured
from ..culling.frustum_box_test import Look
from ..culling.radar import Bounds, bounds, lost, radar, refuse_lost
from ..levels.assignment import Bias, LevelPolicy, assign, deviations, limits
from ..sorting.buckets import Buckets, sort, sort_blocks, sort_in_order
from .index_cache import blocks_at, kept_of, moved

# Another way to cull, give LODs and sort, of the same agents and LODs: (crowd, order, camera,
# policy, begin) -> (places (m,) int32, offsets (n + 1,) intp). Where in `order`, agent indices (n,)
# or None for agent order, the visible agents of LOD k stand is places[offsets[k]:offsets[k + 1]],
# rising. See operators/overlay/gpu_culling.py.
Sorter = Callable[[Crowd, np.ndarray | None, Camera, LevelPolicy, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Frame:
    """What one frame shows, and what it was planned with.

    time: in frames. crowd: of the `trajectory` at that time. eyes, shutter, policy, bias: as for `plan`. begins: (G, n - 1)
    metres, where each group's LODs 1 ... n - 1 begin (levels.limits). vertices, triangles: to be drawn for the visible agents;
    full_vertices, full_triangles: without culling and LOD. milliseconds: of each stage, in the order of the pipeline. dropped:
    agents left out because they stand at NaN or infinity. left_out: what the scene did not need, in the order of the pipeline;
    like the milliseconds it tells how this plan was made, and all else is the same without it. known_levels: the `levels`, where
    they do not follow from the distances alone, or are at hand. shadow, mirrored: agents that are not visible but cast shadows
    into the picture, or are seen in mirrors; None if not looked for (planning/shadows.py).

    What is known of every agent, also of those culled, is found when it is first asked for, and kept; the buckets say who is
    seen, and at which LOD.
    """

    time: float
    crowd: Crowd
    trajectory: Trajectory
    eyes: tuple[Camera, ...]
    shutter: Sequence[tuple[float, Sequence[Camera]]]
    policy: LevelPolicy
    bias: Bias | None
    buckets: Buckets
    begins: np.ndarray
    vertices: int
    triangles: int
    full_vertices: int
    full_triangles: int
    milliseconds: dict[str, float]
    dropped: int = 0
    left_out: tuple[LeftOut, ...] = ()
    known_levels: np.ndarray | None = None
    shadow: Buckets | None = None
    mirrored: Buckets | None = None

    @property
    def camera(self) -> Camera:
        """The first of the eyes."""
        return self.eyes[0]

    @cached_property
    def visible(self) -> np.ndarray:
        """(n,) bool."""
        seen = np.zeros(len(self.crowd), bool)
        seen[self.buckets.order] = True
        return seen

    @cached_property
    def distances(self) -> np.ndarray:
        """(n,) float64 metres, from which LODs follow: those of `radar`."""
        return self._measured(self.eyes, self.policy.metric == "RADIAL")

    @cached_property
    def depths(self) -> np.ndarray:
        """(n,) float64 metres along the first camera's view; of a panoramic camera, from it."""
        same = len(self.eyes) == 1 and self.policy.metric != "RADIAL"
        return self.distances if same else self._measured(self.eyes[:1], False)

    @cached_property
    def factors(self) -> np.ndarray | None:
        """(n,) float64, the bias of each distance, or None."""
        return None if self.bias is None else self.bias.at(self.crowd.x, self.crowd.y)

    @cached_property
    def levels(self) -> np.ndarray:
        """(n,) uint8, the LOD of every agent."""
        if self.known_levels is not None:
            return self.known_levels
        return assign(self.distances, self.begins, self.crowd.group, self.factors)

    def phase_of(self, agents: np.ndarray) -> np.ndarray:
        """(m,) float32 in [0, 1): the places of `agents` (m,) in their action's cycle."""
        return self.trajectory.phase(self.crowd, self.time, agents)

    def _measured(self, eyes: tuple[Camera, ...], radial: bool) -> np.ndarray:
        spheres, leave = self.trajectory.spheres, self.trajectory.left_out
        return radar(self.crowd, eyes, spheres.center, spheres.reach, None, radial, leave, every=True)[1]


def plan(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: float,
    shutter: Sequence[tuple[float, Sequence[Camera]]] = (),
    bias: Bias | None = None,
    lean: bool = True,
    sorter: Sorter | None = None,
) -> Frame:
    """Return the plan of the frame at `time`: a pure function of the arguments.

    The plan does not depend on the frame that came before.

    camera: one, or the eyes of a stereo picture.
    time: in frames; LODs are those of this time.
    shutter: with motion blur, (time in frames, the eyes' cameras from camera.opened) at each sample
        of the open shutter, in order. An agent seen at any of them is visible. With a fixed margin
        nothing is grown for the shutter except by the cameras' motion.
    bias: the painted detail map.
    lean: leave out what the scene does not need.
    sorter: makes the buckets where it can: one camera, no panorama, without shutter, bias or lens
        blur.
    """
    trajectory = trajectory if lean else trajectory.full
    leave, left = trajectory.leave, set(trajectory.left_out)
    groups = trajectory.groups
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    radius, reach = trajectory.spheres.radius, trajectory.spheres.reach
    ticks = [clock.perf_counter()]
    crowd = trajectory.at(time)
    ticks.append(clock.perf_counter())
    grown = reach + most_moved(trajectory, [sample for sample, _ in shutter])
    asked = None
    if STATIC in leave and STILL in left:
        crowds = [crowd, *(trajectory.at(sample) for sample, _ in shutter)]
        painted = None if bias is None else (bias.values.shape, bias.values.tobytes(), bias.area)
        views = [_values(each) for each in (cameras, *(eyes for _, eyes in shutter))]
        asked = [column for each in crowds for column in (each.x, each.y, each.z, each.group)], (
            views, policy, painted, grown.tobytes()
        )  # fmt: skip
        made = kept_of(trajectory).memo
        if made is not None and made[1] == asked[1] and all(map(operator.is_, made[0], asked[0])):
            ticks += [clock.perf_counter()] * 3
            left_out = STATIC, *made[2].left_out
            now = {"time": time, "crowd": crowd, "trajectory": trajectory, "eyes": cameras, "shutter": tuple(shutter)}
            now |= {"policy": policy, "bias": bias}
            return replace(made[2], **now, milliseconds=_milliseconds(ticks), left_out=left_out)
    begin = limits(policy, cameras[0], radius, deviations(groups, policy))
    views = [(time, pictured(cameras), reach), *((sample, pictured(eyes), grown) for sample, eyes in shutter)]
    way = _by_blocks if BLOCKS in leave & trajectory.left_out else _one_by_one
    plain = len(views) == len(cameras) == 1 and bias is None and not cameras[0].turn and cameras[0].kind != "PANO"
    if sorter is not None and plain:
        left -= {item for item in left if item.stage == "culling"}
        way = partial(_elsewhere, sorter)
    buckets, levels, counted, dropped, items = way(trajectory, crowd, views, policy, begin, bias, ticks)
    left |= items
    if ONE_BUCKET in leave and np.count_nonzero(buckets.counts) <= 1:
        left.add(ONE_BUCKET)
    counted = counted or tally(crowd, buckets, len(groups))
    vertices, full_vertices = cost(counted, [g.vertices for g in groups])
    triangles, full_triangles = cost(counted, [g.triangles for g in groups])
    frame = Frame(
        time=time,
        crowd=crowd,
        trajectory=trajectory,
        eyes=cameras,
        shutter=tuple(shutter),
        policy=policy,
        bias=bias,
        buckets=buckets,
        begins=begin,
        vertices=vertices,
        triangles=triangles,
        full_vertices=full_vertices,
        full_triangles=full_triangles,
        milliseconds=_milliseconds(ticks),
        dropped=dropped,
        left_out=tuple(item for item in ITEMS if item in left),
        known_levels=levels,
    )
    # it ends with its trajectory
    kept_of(trajectory).memo = None if asked is None else (*asked, replace(frame, trajectory=None))
    return frame


def _one_by_one(trajectory, crowd, views, policy, begin, bias, ticks) -> tuple:
    """(buckets, all agents' LODs if they are known, what `tally` counts, how many are dropped, what was left out): every agent is tested. views:
    (time, the eyes' cameras, (G,) radii) of each time at which agents may be seen; LODs are those of the first."""
    leave, items = trajectory.leave, set()
    made = blocks_at(trajectory, views[0][0])  # for their order
    (_, cameras, radius), *shutter = views
    centre = trajectory.spheres.center
    about = (centre, radius, policy.margin, policy.metric == "RADIAL", trajectory.left_out)
    box = bounds(crowd, cameras, *about) if leave else Bounds()
    gone = _lost(crowd, policy) if not box.finite else 0
    level = _one_level(begin, box, bias) if ONE_LEVEL in leave else None
    every = box.every if (ALL_INSIDE if box.every else ALL_OUTSIDE) in leave else None
    visible, distance = radar(crowd, cameras, *about, every, measure=level is None)
    for sample, eyes, grown in shutter:
        if every:
            break
        then, about = trajectory.at(sample), (centre, grown, policy.margin, False, trajectory.left_out)
        seen = bounds(then, eyes, *about).every if {ALL_INSIDE, ALL_OUTSIDE} <= leave else None
        visible |= radar(then, eyes, *about, seen, measure=False)[0]
        every = seen if seen or every is False else None
    ticks.append(clock.perf_counter())
    if level is None:
        factor = None if bias is None else bias.at(crowd.x, crowd.y)
        levels = assign(distance, begin, crowd.group, factor)
    else:
        levels = np.full(len(crowd), level, np.uint8)
        items.add(ONE_LEVEL)
    ticks.append(clock.perf_counter())
    if made is None:
        buckets = sort(visible, levels, policy.count, ONE_BUCKET in leave)
    else:
        shown = np.where(visible, levels, CULLED)
        buckets = sort_in_order(shown[made[1].order], made[1].order, policy.count)
    ticks.append(clock.perf_counter())
    if every is not None:
        items.add(ALL_INSIDE if every else ALL_OUTSIDE)
    return buckets, levels, None, gone, items


def _by_blocks(trajectory, crowd, views, policy, begin, bias, ticks) -> tuple:
    """Do the same as `_one_by_one` with blocks decided at once (culling/blocks.py)."""
    since, blocks = blocks_at(trajectory, views[0][0])
    centre = trajectory.spheres.center
    radius, radial = views[0][2], policy.metric == "RADIAL"
    gone = 0 if blocks.finite else _lost(crowd, policy)
    looks = [
        [Look(camera, *moved(trajectory, at, since), float((grown - radius).max())) for camera in eyes] for at, eyes, grown in views
    ]
    decided, places = decide(blocks, crowd, looks, begin if bias is None else None, policy.margin, radial)
    agents = blocks.rows[decided.opened[places // LEAF], places % LEAF]
    leave = trajectory.left_out | {IN_ORDER}
    visible, distance = radar(crowd, views[0][1], centre, radius, policy.margin, radial, leave, agents=agents)
    for at, eyes, grown in views[1:]:
        about = (centre, grown, policy.margin, False, leave)
        visible |= radar(trajectory.at(at), eyes, *about, measure=False, agents=agents)[0]
    ticks.append(clock.perf_counter())
    seen = agents[visible]
    factor = None if bias is None else bias.at(crowd.x[seen], crowd.y[seen])
    decided.own.reshape(-1)[places[visible]] = assign(distance[visible], begin, crowd.group[seen], factor)
    ticks.append(clock.perf_counter())
    buckets, present = sort_blocks(blocks, decided, crowd.group, policy.count)
    ticks.append(clock.perf_counter())
    items = {ALL_INSIDE: len(buckets.order) == len(crowd), ALL_OUTSIDE: not len(buckets.order)}
    items[ONE_LEVEL] = bias is None and np.count_nonzero(buckets.counts) <= 1
    known = trajectory.leave if not len(places) else NOTHING
    items = {item for item, holds in items.items() if holds and item in known}
    counted = present, np.diff(blocks.groups)
    return buckets, None, counted, gone, items


def _elsewhere(sorter: Sorter, trajectory, crowd, views, policy, begin, bias, ticks) -> tuple:
    """Do the same as `_one_by_one` by `sorter`; all of its time counts as culling."""
    made = blocks_at(trajectory, views[0][0])
    gone = 0 if made is not None and made[1].finite else _lost(crowd, policy)
    order = None if made is None else made[1].order
    places, offsets = sorter(crowd, order, views[0][1][0], policy, begin)
    counted = None
    if made is not None:
        edges = [np.searchsorted(places[a:b], made[1].groups) for a, b in zip(offsets[:-1], offsets[1:], strict=True)]
        counted = np.diff(edges, axis=1), np.diff(made[1].groups)
    buckets = Buckets(places if order is None else order[places], offsets)
    ticks += [clock.perf_counter()] * 3
    return buckets, None, counted, gone, set()


def _lost(crowd: Crowd, policy: LevelPolicy) -> int:
    """Return how many agents are dropped at NaN or infinity.

    Raises CrowdError if the policy does not allow any.
    """
    gone = lost(crowd)
    if not policy.drop_lost:
        refuse_lost(gone, len(crowd))
    return len(gone)


def _milliseconds(ticks: list[float]) -> dict[str, float]:
    stages = ("behaviour", "culling", "levels", "sorting")
    return {name: 1000 * float(b - a) for name, a, b in zip(stages, ticks[:-1], ticks[1:], strict=True)}


def _values(cameras: Sequence[Camera]) -> list[tuple]:
    """Return the cameras' values, for comparison."""
    return [tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(camera).values()) for camera in cameras]


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


def most_moved(trajectory: Trajectory, times: Sequence[float]) -> float:
    """Return how many metres an agent may walk between two of the `times`, in frames.

    It is the distance of the whole gap, not of half of it. So an agent that jumps to the other side
    of a wrapping map is covered before and after.
    """
    if len(times) < 2:
        return 0.0
    gap = max(np.diff(times))
    return float(np.linalg.norm(trajectory.machine.velocity, axis=-1).max()) * gap * trajectory.seconds_per_frame


def tally(crowd: Crowd, buckets: Buckets, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Count agents in the buckets, (n, G) by LOD and group, and in the crowd, (G,)."""
    if groups == 1:
        return buckets.counts[:, None], np.array([len(crowd)])
    present = [np.bincount(crowd.group[buckets[level]], minlength=groups) for level in range(len(buckets.counts))]
    return np.array(present), np.bincount(crowd.group, minlength=groups)


def cost(counted: tuple[np.ndarray, np.ndarray], sizes: list[tuple[int, ...]]) -> tuple[int, int]:
    """Return (drawn, full): `sizes` summed over visible agents, and over all agents.

    counted: from `tally`.
    sizes: for each group one number per LOD, or none if not known; then both sums are 0.
    """
    present, full = counted
    if not all(len(each) >= len(present) for each in sizes):
        return 0, 0
    drawn = [int(present[level, g]) * size[level] for g, size in enumerate(sizes) for level in range(len(present))]
    return sum(drawn), sum(int(n) * size[0] for n, size in zip(full, sizes, strict=True))
