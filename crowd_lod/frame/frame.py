"""One frame's plan: behavior > culling > levels > sorting."""

import operator
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import BLOCKS, STATIC, STILL, LeftOut
from ..culling.camera import Camera, as_pictured
from ..culling.coverage import covered_pixels
from ..culling.radar import RadarOptions, radar
from ..levels.assignment import Bias, LevelPolicy, assign, deviations, threshold_distances
from ..sorting.buckets import Buckets
from ..sources.trajectory import Trajectory
from .index_cache import cache_of
from .stages import Moment, Request, Task, moments, sorted_by_level


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Who is seen, at which LOD, and what that costs. It holds for as long as nothing moves.

    thresholds: (G, n - 1) meters, where each group's LODs 1 ... n - 1 begin
        (levels.threshold_distances).
    vertices, triangles: to be drawn for the visible agents.
    full_vertices, full_triangles: without culling and LOD.
    dropped: agents left out because they stand at NaN or infinity.
    left_out: what the scene did not need, in the order of the pipeline. It tells how this plan was
        made; all else is the same without it.
    known_levels: the `levels` of the frame, where they do not follow from the distances alone, or
        are at hand.
    """

    buckets: Buckets
    thresholds: np.ndarray
    vertices: int
    triangles: int
    full_vertices: int
    full_triangles: int
    dropped: int = 0
    left_out: tuple[LeftOut, ...] = ()
    known_levels: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Frame(Request, Outcome):
    """What one frame shows, and what it was planned with.

    crowd: of the `trajectory` at that time.
    milliseconds: of each stage, in the order of the pipeline.
    shadow, mirrored: agents that are not visible but cast shadows into the picture or take light of
        the sky from it, or are seen in mirrors; None if not looked for (frame/shadows.py).
    hidden: (n,) bool, agents in the picture that scenery hides, and who are not in `buckets`; None
        if not looked for (frame/hidden.py).
    plan_row: (n,) uint8, what the shot plan has of the agents (frame/planned.py), if the LODs are
        its, or what overrides alone have; else None.
    by_plan: whether `plan_row` is the shot plan's.
    unplanned: a sentence why a stored shot plan does not give them, or "".

    What is known of every agent, also of those culled, is found when it is first asked for, and
    kept; the buckets say who is seen, and at which LOD.
    """

    crowd: Crowd
    trajectory: Trajectory
    milliseconds: dict[str, float]
    shadow: Buckets | None = None
    mirrored: Buckets | None = None
    hidden: np.ndarray | None = None
    plan_row: np.ndarray | None = None
    by_plan: bool = True
    unplanned: str = ""

    @property
    def planned(self) -> bool:
        """Whether the LODs are those of the shot plan."""
        return self.plan_row is not None and self.by_plan

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

    @property
    def people(self) -> int:
        """How many agents are there, without what they wear."""
        return self.crowd.of(slice(len(self.trajectory.bare.start))).there

    def without_worn(self, buckets: Buckets) -> Buckets:
        """Return `buckets` without what agents wear."""
        wearer = self.trajectory.wearer
        return buckets if wearer is None else buckets.among(wearer == np.arange(len(wearer)))

    @property
    def culled(self) -> np.ndarray:
        """(n,) bool: agents that exist but are outside the view."""
        present = self.crowd.present
        return ~self.visible if present is None else present & ~self.visible

    def covered(self) -> float:
        """Return roughly how many pixels of the picture the visible agents cover."""
        agents = self.buckets.order
        spheres = self.trajectory.spheres
        places = np.stack(self.crowd.places(spheres.center, agents, self.camera.origin))
        radius = spheres.radius[self.crowd.group[agents]]
        return covered_pixels(self.camera, places, radius)

    @cached_property
    def distances(self) -> np.ndarray:
        """(n,) float64 meters, from which LODs follow: those of `radar`."""
        return self._measure(self.eyes)

    @cached_property
    def depths(self) -> np.ndarray:
        """(n,) float64 meters along the first camera's view; of a panoramic camera, from it."""
        return self.distances if len(self.eyes) == 1 else self._measure(self.eyes[:1])

    @cached_property
    def factors(self) -> np.ndarray | None:
        """(n,) float64, the bias of each distance, or None."""
        return None if self.bias is None else self.bias.at(self.crowd.x, self.crowd.y)

    @cached_property
    def levels(self) -> np.ndarray:
        """(n,) uint8, the LOD of every agent."""
        if self.known_levels is not None:
            return self.known_levels
        return assign(self.distances, self.thresholds, self.crowd.group, self.factors)

    def phase_of(self, agents: np.ndarray) -> np.ndarray:
        """(m,) float32 in [0, 1): the places of `agents` (m,) in their action's cycle."""
        return self.trajectory.phase(self.crowd, self.time, agents)

    def _measure(self, eyes: tuple[Camera, ...]) -> np.ndarray:
        spheres = self.trajectory.spheres
        return radar(self.crowd, eyes, spheres.center, spheres.reach, RadarOptions(cull=False))[1]


def plan(
    trajectory: Trajectory,
    camera: Camera | Sequence[Camera],
    policy: LevelPolicy,
    time: float,
    shutter: Sequence[tuple[float, Sequence[Camera]]] = (),
    bias: Bias | None = None,
) -> Frame:
    """Return the plan of the frame at `time`: a pure function of the arguments.

    The plan does not depend on the frame that came before.

    camera: one, or the eyes of a stereo picture.
    The other arguments are those of `Request`.
    """
    eyes = (camera,) if isinstance(camera, Camera) else tuple(camera)
    return plan_of(
        trajectory, Request(time=time, eyes=eyes, policy=policy, shutter=tuple(shutter), bias=bias)
    )


def plan_of(trajectory: Trajectory, request: Request) -> Frame:
    """Return the frame that is asked for: a pure function of `trajectory` and `request`."""
    ticks = [clock.perf_counter()]
    crowd = trajectory.at(request.time)
    ticks.append(clock.perf_counter())
    views = [
        replace(moment, eyes=as_pictured(moment.eyes)) for moment in moments(trajectory, request)
    ]
    inputs = None
    outcome = None
    if trajectory.stays:
        inputs = _inputs(trajectory, crowd, request, views)
        outcome = _recall(trajectory, *inputs)
    if outcome is not None:
        ticks += [clock.perf_counter()] * 3
        outcome = replace(outcome, left_out=(STATIC, *outcome.left_out))
    else:
        thresholds = threshold_distances(
            request.policy,
            request.eyes[0],
            trajectory.spheres.radius,
            deviations(trajectory.groups, request.policy),
        )
        outcome = _outcome(Task(trajectory, request, crowd, views, thresholds, ticks))
        cache_of(trajectory).memo = None if inputs is None else (*inputs, outcome)
    requested = {field.name: getattr(request, field.name) for field in fields(Request)}
    return Frame(
        **requested,
        **vars(outcome),
        crowd=crowd,
        trajectory=trajectory,
        milliseconds=_milliseconds(ticks),
    )


def _inputs(
    trajectory: Trajectory, crowd: Crowd, request: Request, views: list[Moment]
) -> tuple[list[np.ndarray], tuple]:
    """Return (arrays of the crowd, values), from which the frame of a crowd that stays follows."""
    crowds = [crowd, *(trajectory.at(moment.time) for moment in views[1:])]
    bias = request.bias
    painted = None if bias is None else (bias.values.shape, bias.values.tobytes(), bias.area)
    cameras = [(_values(moment.eyes), moment.radius.tobytes()) for moment in views]
    columns = [column for crowd in crowds for column in (crowd.x, crowd.y, crowd.z, crowd.group)]
    return columns, (cameras, request.policy, painted)


def _recall(trajectory: Trajectory, columns: list[np.ndarray], values: tuple) -> Outcome | None:
    """Return the last frame's outcome, if it was planned from the same inputs."""
    memo = cache_of(trajectory).memo
    if memo is None:
        return None
    memo_columns, memo_values, outcome = memo
    is_same = memo_values == values and all(map(operator.is_, memo_columns, columns))
    return outcome if is_same else None


def _values(cameras: Sequence[Camera]) -> list[tuple]:
    """Return the cameras' values, for comparison."""
    return [
        tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(camera).values())
        for camera in cameras
    ]


def _outcome(task: Task) -> Outcome:
    """Return who is seen, and what that costs."""
    groups = task.trajectory.groups
    result = sorted_by_level(task)
    buckets = result.buckets
    present = task.crowd.present
    if present is not None:
        buckets = buckets.among(present)
    counted = result.counted if present is None else None
    counted = counted or tally(task.crowd, buckets, len(groups))
    vertices, full_vertices = cost(counted, [group.vertices for group in groups])
    triangles, full_triangles = cost(counted, [group.triangles for group in groups])
    return Outcome(
        buckets=buckets,
        thresholds=task.thresholds,
        vertices=vertices,
        triangles=triangles,
        full_vertices=full_vertices,
        full_triangles=full_triangles,
        dropped=result.dropped,
        left_out=(STILL,) * task.trajectory.still + (BLOCKS,) * result.in_blocks,
        known_levels=result.levels,
    )


def _milliseconds(ticks: list[float]) -> dict[str, float]:
    stages = ("behavior", "culling", "levels", "sorting")
    return {
        name: 1000 * float(b - a) for name, a, b in zip(stages, ticks[:-1], ticks[1:], strict=True)
    }


def tally(crowd: Crowd, buckets: Buckets, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (agents in the buckets, (n, G) by LOD and group; agents that are there, (G,))."""
    if groups == 1:
        return buckets.counts[:, None], np.array([crowd.there])
    visible = [
        np.bincount(crowd.group[buckets[level]], minlength=groups)
        for level in range(len(buckets.counts))
    ]
    there = crowd.group if crowd.present is None else crowd.group[crowd.present]
    return np.array(visible), np.bincount(there, minlength=groups)


def cost(counted: tuple[np.ndarray, np.ndarray], sizes: list[tuple[int, ...]]) -> tuple[int, int]:
    """Return (drawn, full): `sizes` summed over visible agents, and over all agents.

    counted: from `tally`.
    sizes: for each group one number per LOD, or none if not known; then both sums are 0.
    """
    present, full = counted
    if not all(len(size) >= len(present) for size in sizes):
        return 0, 0
    shown_sizes = [
        int(present[level, g]) * size[level]
        for g, size in enumerate(sizes)
        for level in range(len(present))
    ]
    return sum(shown_sizes), sum(int(n) * size[0] for n, size in zip(full, sizes, strict=True))
