"""Culling and LODs of a frame: agents that ways to compute them get wrong, and what each takes.

The judge is exact arithmetic (validation/exact_frustum.py). Rows are flat dicts that share their
keys, for CSV and plots.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..behavior.plain_step import advance
from ..behavior.walk import walks_of
from ..crowd import leave_outs as parts
from ..crowd.agents import Crowd, Group
from ..crowd.bounds import VelocityBounds
from ..culling.camera import Camera
from ..culling.radar import RadarOptions, radar
from ..culling.volumes import Light, Mirror
from ..frame.frame import Frame, plan
from ..frame.frame_range import spread_evenly
from ..frame.index_cache import SHUTTER, cache_of
from ..frame.shadows import Surroundings, surround
from ..levels.assignment import LevelPolicy, assign, deviations, threshold_distances
from ..sorting.buckets import sort
from ..sources.points import STATES
from ..sources.trajectory import States, Trajectory
from ..world.maps import Area
from .exact_frustum import find_levels, find_visible
from .timing import time_in_turn

FRAMES = "as frames run it"
RADAR = "radar, every agent"
SINGLE = "listing 1.2, float32"
NAIVE = "listing 1.2, naive NumPy"
MATRIX = "planes of a matrix"
EXACT = "exact rationals"
BY_EYE = {f"Delta by eye, {delta:g} m": delta for delta in (0.0, 0.5, 1.0, 2.0, 5.0)}
SPAN = 16  # frames in a row that a run computes
JUDGED = 0, 7, 15  # of them
AROUND = 1.0  # meters, at most, along each axis: copies of agents from those that they copy
WRONG = "missed", "outside", "lods_off", "visible"
# what surroundings that a scene lacks would be, for the time that it takes to look for them
SUN = Light(None, np.array([0.6, 0.0, -0.8]))
PANE = Mirror(np.array([0.0, 1.0, 0.0]), np.array([[-5, 0, 0], [5, 0, 0], [5, 0, 5], [-5, 0, 5.0]]))


@dataclass(eq=False)
class Replayed(Trajectory):
    """Frames of a crowd as they were, at whole frames alone.

    crowds: one for each frame from `first_frame` on.
    bounds: of all velocities; None if they are not known.
    """

    crowds: Sequence[Crowd]
    groups: tuple[Group, ...]
    bounds: VelocityBounds | None
    first_frame: int = 1
    seconds_per_frame: float = 1 / 24
    heights: None = None
    every: int = SPAN

    def __post_init__(self) -> None:
        self.start = self.crowds[0]

    @property
    def area(self) -> Area:
        """A rectangle about all places at the first frame."""
        places = np.array([self.start.x, self.start.y])
        finite = np.where(np.isfinite(places), places, 0.0)
        (left, low), (right, high) = finite.min(axis=1), finite.max(axis=1) + 1
        return Area(float(left), float(low), float(right), float(high), 0.0)

    @property
    def states(self) -> States:
        """One for all."""
        return STATES

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return the bounds."""
        return self.bounds

    def at(self, time: float) -> Crowd:
        """Return the crowd of the frame; that of the last one after it."""
        number = int(max(time - self.first_frame, 0))
        return self.crowds[min(number, len(self.crowds) - 1)]

    def digests(self) -> dict[str, bytes]:
        """Return nothing: no shot plan is made for it."""
        return {}


def replayed(trajectory: Trajectory, first: int, count: int) -> Replayed:
    """Return SPAN frames of a crowd of `count` agents, copied from those of the `trajectory`."""
    random = np.random.default_rng(0)
    agents = len(trajectory.start)
    rows = np.arange(count) % agents
    if count < agents:
        rows = np.array(spread_evenly(range(agents), count), np.intp)
    aside = random.uniform(-AROUND, AROUND, (2, count)) * (np.arange(count) >= agents)
    crowds = []
    for frame in range(first, first + SPAN):
        crowd = trajectory.at(frame).of(rows)
        crowds.append(replace(crowd, x=crowd.x + aside[0], y=crowd.y + aside[1]))
    bounds = trajectory.velocity(first - SHUTTER, first + SPAN + SHUTTER)
    known = None if trajectory.wraps else bounds  # those who come back at the other side jump
    return Replayed(crowds, trajectory.groups, known, first, trajectory.seconds_per_frame)


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

    @property
    def places(self) -> np.ndarray:
        """(n, 3) world meters, of the spheres."""
        return np.stack(self.crowd.places(self.center), axis=1)


Way = Callable[[FrameToCull], Found]


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
    WRONG: agents of a frame: visible ones that are missed, drawn ones outside the view, LODs off by
        one or more, and the visible ones.
    """
    for count in counts:
        crowd = replayed(trajectory, first, count)
        frames = zip(crowd.crowds, cameras, strict=True)
        views = [_view(crowd, each, camera, policy) for each, camera in frames]
        ways: dict[str, Callable[[], list]] = {
            name: partial(_all, way, views) for name, way in _ways(cameras[0]).items()
        }
        ways[FRAMES] = partial(_plans, crowd, cameras, policy)
        times = time_in_turn(ways, runs)
        judged = [views[number] for number in JUDGED]
        truth = _all(exactly, judged)
        for name, run in ways.items():
            every = run()
            found = [every[number] for number in JUDGED]
            wrong = np.mean(list(map(_wrong, found, truth, judged)), axis=0)
            yield {
                "way": name,
                "delta_m": BY_EYE.get(name, ""),
                "agents": count,
                **times[name].row(SPAN),
                **dict(zip(WRONG, wrong.tolist(), strict=True)),
                "default": int(name == FRAMES),
            }


def _wrong(found: Found | Frame, truth: Found, view: FrameToCull) -> tuple[int, ...]:
    """Return the numbers of WRONG; agents that are hidden or not there yet no way may keep."""
    there = True if view.crowd.present is None else view.crowd.present
    shown, visible = found.visible & there, truth.visible & there
    off = (found.levels != truth.levels)[shown & visible]
    sets = visible & ~shown, shown & ~visible, off, visible
    return tuple(int(each.sum()) for each in sets)


def _view(of: Trajectory, crowd: Crowd, camera: Camera, policy: LevelPolicy) -> FrameToCull:
    spheres = of.spheres
    bare = replace(camera, pad=0.0, turn=0.0, filtered=0.0, cone=np.pi, rays=False)
    begin = threshold_distances(policy, camera, spheres.radius, deviations(of.groups, policy))
    return FrameToCull(crowd, bare, spheres.center, spheres.reach, begin)


def _ways(camera: Camera) -> dict[str, Way]:
    """Return the ways to cull by name; panoramic cameras have no planes."""
    ways: dict[str, Way] = {RADAR: _by_radar, EXACT: exactly}
    if camera.kind == "PANO":
        return ways
    flat: dict[str, Way] = {
        MATRIX: _by_matrix,
        NAIVE: _by_listing,
        SINGLE: partial(_by_listing, kind=np.float32),
    }
    by_eye = {name: partial(_by_radar, margin=delta) for name, delta in BY_EYE.items()}
    return ways | by_eye | flat


def _all(way: Way, views: Sequence[FrameToCull]) -> list[Found]:
    return [way(view) for view in views]


def _plans(crowd: Replayed, cameras: Sequence[Camera], policy: LevelPolicy) -> list[Frame]:
    """Return the plan of each frame, as frames run it: their blocks are made once."""
    cache_of(crowd).boxes = None
    times = range(crowd.first_frame, crowd.first_frame + SPAN)
    return [plan(crowd, camera, policy, time) for camera, time in zip(cameras, times, strict=True)]


def _by_radar(view: FrameToCull, margin: float | None = None) -> Found:
    options = RadarOptions(margin)
    visible, distance = radar(view.crowd, view.camera, view.center, view.radius, options)
    levels = assign(distance, view.thresholds, view.crowd.group)
    sort(visible, levels, view.thresholds.shape[1] + 1)
    return Found(visible, levels)


def _by_listing(view: FrameToCull, kind: type[np.floating] = np.float64) -> Found:
    """Cull as listing 1.2 says, all agents at once, in arithmetic of this kind."""
    camera = view.camera
    group = view.crowd.group
    r = view.radius.astype(kind)[group]
    v = view.places.astype(kind) - camera.origin.astype(kind)
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
    projection = np.array([[2 / wide, 0, 0, 0], [0, 2 / tall, 0, 0], depth, last], np.float64)
    shift = [(w.right + w.left) / wide, (w.top + w.bottom) / tall]
    projection[:2, 3 if camera.kind == "ORTHO" else 2] = np.negative(shift)
    turn = np.array([camera.X, camera.Y, camera.Z])
    rows = projection @ np.block([[turn, -turn @ camera.origin[:, None]], [np.eye(4)[3:]]])
    planes = np.concatenate([rows[3] + rows[:3], rows[3] - rows[:3]])
    planes /= np.linalg.norm(planes[:, :3], axis=1)[:, None]
    group = view.crowd.group
    places = view.places
    away = places @ planes[:, :3].T + planes[:, 3]
    visible = (away >= -view.radius[group][:, None]).all(axis=1)
    distance = places @ camera.Z - camera.origin @ camera.Z
    return Found(visible, assign(distance, view.thresholds, group))


def exactly(view: FrameToCull) -> Found:
    """Return who is visible, and the LODs, without rounding but for the heights of centers."""
    group = view.crowd.group
    places = view.places
    visible, _ = find_visible(view.camera, places, view.radius[group])
    return Found(visible, find_levels(view.camera, places, view.thresholds[group]))


def leave_outs(
    trajectory: Trajectory,
    camera: Camera,
    policy: LevelPolicy,
    frame: int,
    beside: Sequence[parts.LeftOut],
    runs: int,
) -> Iterator[dict]:
    """Yield a row for each part that frames of this scene leave out: its time with and without.

    Without is what plain functions take that leave nothing out, and give the same; of surroundings
    that the scene lacks, what looking for one of them takes.

    camera: at `frame`. beside: what its surroundings leave out.
    """
    plan(trajectory, camera, policy, frame)
    planned = plan(trajectory, camera, policy, frame)
    view = _view(trajectory, planned.crowd, camera, policy)
    again = partial(plan, trajectory, camera, policy, frame)
    every = partial(_by_radar, view, policy.margin)
    steps = partial(_step_all, trajectory)
    alone, sun, sky, pane = (
        partial(surround, planned, around)
        for around in (
            Surroundings(),
            Surroundings(lights=(SUN,)),
            Surroundings(sky=True),
            Surroundings(mirrors=(PANE,)),
        )
    )
    table: dict[parts.LeftOut, tuple[str, Callable[[], object], Callable[[], object]]] = {
        parts.STATIC: ("The plan, as nothing moves", again, every),
        parts.STILL: ("Steps, as nobody moves", partial(trajectory.at, frame), steps),
        parts.BLOCKS: ("Agents of whole blocks", again, every),
        parts.NO_SHADOWS: ("Shadows, as no light casts any", alone, sun),
        parts.NO_MIRRORS: ("Mirrors, as none is chosen", alone, pane),
        parts.NO_SKY: ("Light of the sky, as there is none", alone, sky),
        parts.SKY_NOT_WANTED: ("Light of the sky, as it is off", alone, sky),
        parts.NOT_WANTED: ("Shadows, as they are off", alone, sun),
        parts.WORKBENCH: ("Shadows, as Workbench has none", alone, sun),
    }
    left = [part for part in (*planned.left_out, *beside) if part in table]
    if parts.STATIC in left:  # blocks with it
        left = [part for part in left if part is not parts.BLOCKS]
    for part in left:
        name, short, whole = table[part]
        times = time_in_turn({"with": short, "without": whole}, runs)
        yield {
            "part": name,
            "agents": len(planned.crowd),
            **{f"{key}_ms": each.row()["cpu_ms"] for key, each in times.items()},
            "steady": int(all(each.is_steady for each in times.values())),
        }


def _step_all(trajectory: Trajectory) -> None:
    for walk in walks_of(trajectory):
        advance(walk.start, walk.machine, walk.world, walk.seconds_per_frame)
