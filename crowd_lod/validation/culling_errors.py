"""Culling and LODs of a frame: agents that ways to compute them get wrong, and what each takes.

The judge is exact arithmetic (validation/exact_frustum.py). Rows are flat dicts that share their
keys, for CSV and plots.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction as F
from functools import partial
from typing import NamedTuple

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.bounds import VelocityBounds
from ..crowd.leave_outs import BLOCKS
from ..culling.camera import Camera
from ..culling.radar import RadarOptions, radar
from ..frame.frame import Frame, plan
from ..frame.frame_range import spread_evenly
from ..frame.index_cache import cache_of
from ..levels.assignment import LevelPolicy, assign, deviations, threshold_distances
from ..sorting.buckets import sort
from ..sources.trajectory import States, Trajectory
from ..world.maps import Area
from .exact_frustum import find_visible
from .timing import time_in_turn

FRAMES = "as frames run it"
RADAR = "radar, every agent"
SINGLE = "listing 1.2, float32"
NAIVE = "listing 1.2, naive NumPy"
MATRIX = "planes of a matrix"
BY_EYE = "Delta by eye"
EXACT = "exact rationals"
DELTAS = 0.0, 0.5, 1.0, 2.0, 5.0  # meters, as set by eye
SPAN = 16  # frames in a row that a run computes
JUDGED = 3  # of them
AROUND = 1.0  # meters, at most, along each axis: copies of agents from those that they copy


class Replayed(Trajectory):
    """Frames of a crowd as they were, at whole frames alone, with the bounds of their motion.

    trajectory: whose frames they are.
    crowds: one for each of its frames from `first` on.
    """

    heights = None
    every = SPAN

    def __init__(self, trajectory: Trajectory, crowds: Sequence[Crowd], first: int):
        self.crowds = crowds
        self._area = _area_of(crowds)
        self.start = crowds[0]
        self.groups = trajectory.groups
        self.gaits = trajectory.gaits
        self.seconds_per_frame = trajectory.seconds_per_frame
        self.first_frame = first
        self._of = trajectory

    @property
    def area(self) -> Area:
        return self._area

    @property
    def states(self) -> States:
        return self._of.states

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return those of the trajectory; None where agents come back at the map's other side."""
        return None if self._of.wraps else self._of.velocity(since, until)

    def at(self, time: float) -> Crowd:
        """Return the crowd of the frame, that of the last one after it."""
        number = int(max(time - self.first_frame, 0))
        return self.crowds[min(number, len(self.crowds) - 1)]

    def digests(self) -> dict[str, bytes]:
        """Return nothing: no shot plan is made for it."""
        return {}


def _area_of(crowds: Sequence[Crowd]) -> Area:
    """Return a rectangle about all places of the crowds, meters."""
    places = np.array([[crowd.x, crowd.y] for crowd in crowds])
    finite = np.where(np.isfinite(places), places, 0.0)
    (left, low), (right, high) = (edge(finite, axis=(0, 2)) for edge in (np.min, np.max))
    return Area(float(left), float(low), float(right) + 1, float(high) + 1, 0.0)


def replayed(trajectory: Trajectory, first: int, count: int) -> Replayed:
    """Return SPAN frames of a crowd of `count` agents, copied from those of the `trajectory`."""
    random = np.random.default_rng(0)
    agents = len(trajectory.start)
    rows = np.arange(count) % agents
    if count < agents:
        rows = np.array(spread_evenly(range(agents), count), np.intp)
    is_copy = np.arange(count) >= agents
    aside = random.uniform(-AROUND, AROUND, (2, count)) * is_copy
    crowds = []
    for frame in range(first, first + SPAN):
        crowd = trajectory.at(frame).of(rows)
        crowds.append(replace(crowd, x=crowd.x + aside[0], y=crowd.y + aside[1]))
    return Replayed(trajectory, crowds, first)


class Found(NamedTuple):
    """A frame's result: who is visible, (n,) bool, and each agent's LOD, (n,) uint8."""

    visible: np.ndarray
    levels: np.ndarray


@dataclass(frozen=True)
class FrameToCull:
    """A frame to cull: its crowd and the camera.

    center, radius: (G,) meters, of the groups' bounding spheres.
    thresholds: (G, n - 1) meters, where LODs begin.
    """

    crowd: Crowd
    camera: Camera
    center: np.ndarray
    radius: np.ndarray
    thresholds: np.ndarray


def compare_culling(
    trajectory: Trajectory,
    cameras: Sequence[Camera],
    policy: LevelPolicy,
    first: int,
    counts: Sequence[int],
    runs: int,
) -> Iterator[dict]:
    """Yield a row for each way to cull, for each count of agents.

    cameras: at SPAN frames from `first` on; what they add for blur and pixel filters counts for
        the way of frames alone.
    runs: of each way, at least, of SPAN frames.
    missed, in_vain, lods_off: agents of a frame.
    """
    margin = policy.margin
    for count in counts:
        crowd = replayed(trajectory, first, count)
        views = _views(crowd, cameras, policy)
        ways = _ways(cameras[0])
        runs_of: dict[tuple[str, float | None], Callable[[], list]] = {
            key: partial(_all, way, views) for key, way in ways.items()
        }
        runs_of[FRAMES, margin] = partial(_plans, crowd, cameras, policy)
        times = time_in_turn(runs_of, runs)
        judged = np.linspace(0, SPAN - 1, JUDGED).astype(int).tolist()
        truth = [_of_present(exactly(views[n]), views[n].crowd) for n in judged]
        frames = _plans(crowd, cameras, policy)
        for key in runs_of:
            found = [_found(frames[n]) if key[0] == FRAMES else ways[key](views[n]) for n in judged]
            results = [
                _of_present(each, views[n].crowd) for each, n in zip(found, judged, strict=True)
            ]
            yield _row(count, key, times[key].row, results, truth)


def _row(
    count: int, key: tuple[str, float | None], times: dict, results: list[Found], truth: list[Found]
) -> dict:
    """Return the row of a way; times: of SPAN frames."""
    name, delta = key
    pairs = list(zip(results, truth, strict=True))
    missed = [int((true.visible & ~found.visible).sum()) for found, true in pairs]
    in_vain = [int((found.visible & ~true.visible).sum()) for found, true in pairs]
    off = [
        int((found.levels != true.levels)[found.visible & true.visible].sum())
        for found, true in pairs
    ]
    return {
        "way": name,
        "delta_m": "" if delta is None else delta,
        "agents": count,
        **{key: value / SPAN if "ms" in key else value for key, value in times.items()},
        "missed": float(np.mean(missed)),
        "in_vain": float(np.mean(in_vain)),
        "lods_off": float(np.mean(off)),
        "visible": float(np.mean([true.visible.sum() for true in truth])),
        "default": int(name == FRAMES),
    }


def _views(crowd: Replayed, cameras: Sequence[Camera], policy: LevelPolicy) -> list[FrameToCull]:
    spheres = crowd.spheres
    found = deviations(crowd.groups, policy)
    views = []
    for number, camera in enumerate(cameras):
        bare = replace(camera, pad=0.0, turn=0.0, filtered=0.0, cone=np.pi, rays=False)
        begin = threshold_distances(policy, camera, spheres.radius, found)
        views.append(FrameToCull(crowd.crowds[number], bare, spheres.center, spheres.reach, begin))
    return views


def _ways(camera: Camera) -> dict[tuple[str, float | None], Callable[[FrameToCull], Found]]:
    """Return the ways to cull by (name, meters of a Delta); panoramic cameras have no planes."""
    ways: dict[tuple[str, float | None], Callable[[FrameToCull], Found]] = {
        (RADAR, None): partial(_by_radar, margin=None),
        (EXACT, None): exactly,
    }
    if camera.kind != "PANO":
        ways |= {(BY_EYE, delta): partial(_by_radar, margin=delta) for delta in DELTAS}
        ways[MATRIX, None] = _by_matrix
        ways[NAIVE, None] = partial(_by_listing, kind=np.float64)
        ways[SINGLE, None] = partial(_by_listing, kind=np.float32)
    return ways


def _all(way: Callable[[FrameToCull], Found], views: Sequence[FrameToCull]) -> list[Found]:
    return [way(view) for view in views]


def _plans(crowd: Replayed, cameras: Sequence[Camera], policy: LevelPolicy) -> list:
    """Return the plan of each frame, as frames run it: their blocks are made once."""
    cache_of(crowd).boxes = None
    return [
        plan(crowd, camera, policy, crowd.first_frame + number)
        for number, camera in enumerate(cameras)
    ]


def _of_present(found: Found, crowd: Crowd) -> Found:
    """Return the result without agents that are hidden or not there yet: no way may keep them."""
    is_there = True if crowd.present is None else crowd.present
    return found._replace(visible=found.visible & is_there)


def _found(frame: Frame) -> Found:
    return Found(frame.visible, frame.levels)


def _by_radar(view: FrameToCull, margin: float | None) -> Found:
    options = RadarOptions(margin)
    visible, distance = radar(view.crowd, view.camera, view.center, view.radius, options)
    levels = assign(distance, view.thresholds, view.crowd.group)
    sort(visible, levels, view.thresholds.shape[1] + 1)
    return Found(visible, levels)


def _by_listing(view: FrameToCull, kind: type[np.floating]) -> Found:
    """Cull as listing 1.2 says, all agents at once, in arithmetic of this kind."""
    camera = view.camera
    group = view.crowd.group
    r = view.radius.astype(kind)[group]
    places = np.stack(view.crowd.places(view.center), axis=1).astype(kind)
    v = places - camera.origin.astype(kind)
    x, y, z = (v @ axis.astype(kind) for axis in (camera.X, camera.Y, camera.Z))
    visible = (z >= kind(camera.near) - r) & (z <= kind(camera.far) + r)
    w = camera.window
    flat = camera.kind == "ORTHO"
    for at, low, high in ((x, w.left, w.right), (y, w.bottom, w.top)):
        for side, sign in ((high, 1), (low, -1)):
            edge = kind(side) * (1 if flat else z)
            delta = r * (1 if flat else np.sqrt(kind(1 + side * side)))
            visible &= sign * at <= sign * edge + delta
    return Found(visible, assign(z, view.thresholds.astype(kind), group))


def _by_matrix(view: FrameToCull) -> Found:
    """Cull by the six planes of a projection matrix (Gribb and Hartmann 2001)."""
    camera = view.camera
    w = camera.window
    near, far = camera.near, camera.far
    if camera.kind == "ORTHO":
        last = [0, 0, 0, 1]
        depth = [0, 0, 2 / (far - near), -(far + near) / (far - near)]
    else:
        last = [0, 0, 1, 0]
        depth = [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)]
    wide, tall = w.right - w.left, w.top - w.bottom
    shift = np.array([(w.right + w.left) / wide, (w.top + w.bottom) / tall])
    projection = np.array([[2 / wide, 0, 0, 0], [0, 2 / tall, 0, 0], depth, last], np.float64)
    projection[[0, 1], 3 if camera.kind == "ORTHO" else 2] = -shift
    view_matrix = np.eye(4)
    view_matrix[:3, :3] = camera.X, camera.Y, camera.Z
    view_matrix[:3, 3] = -view_matrix[:3, :3] @ camera.origin
    rows = projection @ view_matrix
    planes = np.concatenate([rows[3] + rows[:3], rows[3] - rows[:3]])
    planes /= np.linalg.norm(planes[:, :3], axis=1)[:, None]
    places = np.stack(view.crowd.places(view.center), axis=1)
    away = places @ planes[:, :3].T + planes[:, 3]
    visible = (away >= -view.radius[view.crowd.group][:, None]).all(axis=1)
    distance = places @ camera.Z - camera.origin @ camera.Z
    return Found(visible, assign(distance, view.thresholds, view.crowd.group))


def exactly(view: FrameToCull) -> Found:
    """Return who is visible, and the LODs, without rounding."""
    points = np.stack(view.crowd.places(view.center), axis=1)
    visible, _ = find_visible(view.camera, points, view.radius[view.crowd.group])
    return Found(visible, exact_levels(view))


def exact_levels(view: FrameToCull) -> np.ndarray:
    """Return exact LOD ids, (n,) uint8.

    Rational arithmetic decides for agents whose distance is within float64's bound on rounding of
    a threshold; float64 decides for the others.
    """
    camera = view.camera
    crowd = view.crowd
    radial = camera.kind == "PANO"
    v = np.stack(crowd.places(view.center)) - camera.origin[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.sqrt((v * v).sum(axis=0)) if radial else camera.Z @ v
        begin = view.thresholds[crowd.group]
        levels = (distance[:, None] >= begin).sum(axis=1).astype(np.uint8)
        size = np.abs(v).sum(axis=0) + np.abs(camera.origin).sum()
        bound = 1e-13 * (size[:, None] + np.abs(begin))
        close = (np.abs(distance[:, None] - begin) <= bound) & np.isfinite(begin)
    for agent in np.flatnonzero(close.any(axis=1)).tolist():
        levels[agent] = _exact_level(view, agent, radial)
    return levels


def _exact_level(view: FrameToCull, agent: int, radial: bool) -> int:
    """Return the LOD of an agent, exact but for its center's height, added in float64."""
    crowd, camera = view.crowd, view.camera
    z = float(crowd.z[agent] + view.center[crowd.group[agent]])
    place = float(crowd.x[agent]), float(crowd.y[agent]), z
    v = [F(p) - F(float(c)) for p, c in zip(place, camera.origin, strict=True)]
    begin = view.thresholds[crowd.group[agent]]
    finite = [F(float(each)) for each in begin if np.isfinite(each)]
    level = int((begin == -np.inf).sum())
    if radial:
        square = sum(p * p for p in v)
        return level + sum(each < 0 or square >= each * each for each in finite)
    along = sum(p * F(float(q)) for p, q in zip(v, camera.Z, strict=True))
    return level + sum(along >= each for each in finite)


def leave_outs(
    trajectory: Trajectory, camera: Camera, policy: LevelPolicy, frame: int, runs: int
) -> Iterator[dict]:
    """Yield a row for each part that frames of this scene leave out: its time with and without.

    Without is what plain functions take that leave nothing out, and give the same. Of a crowd that
    stands still the whole plan is left out, and blocks with it.

    camera: at `frame`.
    """
    planned = plan(trajectory, camera, policy, frame)
    spheres = trajectory.spheres
    view = FrameToCull(
        planned.crowd, planned.camera, spheres.center, spheres.reach, planned.thresholds
    )
    parts = ["Blocks"] if BLOCKS in planned.left_out else []
    if trajectory.still:
        parts = ["The plan of a crowd and a camera that stand still"]
    ways: dict[str, Callable[[], object]] = {
        "with": partial(plan, trajectory, camera, policy, frame),
        "without": partial(_by_radar, view, policy.margin),
    }
    for part in parts:
        times = time_in_turn(ways, runs)
        yield {
            "part": part,
            "agents": len(planned.crowd),
            **{f"{name}_ms": each.row["cpu_ms"] for name, each in times.items()},
            "steady": int(all(each.is_steady for each in times.values())),
        }
