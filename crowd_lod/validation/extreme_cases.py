"""Extreme cases of plans, each with a name: culling and LODs beside exact arithmetic."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..crowd.agents import Draw, Group
from ..crowd.bounds import STANDING, VelocityBounds
from ..culling.camera import GRAIN, Camera, referential, window
from ..format import aligned
from ..frame.frame import Frame, plan
from ..levels.assignment import LevelPolicy
from ..sources.points import Points, Snapshot, draw_for
from . import stiff_cases
from .culling_errors import FrameToCull, Replayed, exact_levels
from .exact_frustum import depth_off, find_visible, scatter, standing_crowd

ROUNDING = 1e-12  # of coordinates, beside GRAIN: what is kept within it is kept for rounding
POLICY = LevelPolicy((0.1, 0.15, 0.4, 1.0))
PART = 1_000_000  # agents that are judged at a time


@dataclass(frozen=True)
class BoundedError:
    """A line of the table: how large an error is in a case, and how large it may be.

    quantity: what is wrong, with its unit.
    """

    case: str
    quantity: str
    error: float
    bound: float

    @property
    def ok(self) -> bool:
        """Whether the error is within its bound; NaN is not."""
        return self.error <= self.bound


@dataclass(frozen=True)
class SpheresInView:
    """What a case of culling shows.

    points: (n, 3) world meters. radius: (G,) meters, of the groups. group: (n,) uint8.
    lost: agents at NaN or infinity.
    bounds: meters by which the LODs of all groups deviate; () for LODs by distance.
    """

    camera: Camera
    points: np.ndarray
    radius: np.ndarray
    group: np.ndarray
    bounds: tuple[float, ...] = ()

    @property
    def lost(self) -> np.ndarray:
        return ~np.isfinite(self.points).all(axis=1)


Maker = Callable[[np.random.Generator], SpheresInView]


class _Standing(Replayed):
    """A crowd that stands still, at one frame."""

    def velocity(self, since: float, until: float) -> VelocityBounds | None:
        """Return that of who stands."""
        return STANDING


def camera_of(
    fov: float = 50.0,
    clip: tuple[float, float] = (0.1, 100.0),
    offset: float = 0.0,
    direction: tuple[float, float, float] = (0.3, 0.9, -0.2),
    kind: str = "PERSP",
    scale: float = 1.0,
) -> Camera:
    """Return a camera, 16 : 9, at (1, -1, 1) x offset that looks in `direction`.

    fov: degrees across; for ORTHO meters.
    clip: near and far, meters.
    scale: of the camera's object; below 0 it is mirrored.
    """
    back = -np.array(direction, np.float64) / np.linalg.norm(direction)
    side = np.cross((0.0, 1.0, 0.0) if abs(back[2]) > 0.9 else (0.0, 0.0, 1.0), back)
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, 0] = side
    matrix[:3, 1] = np.cross(back, side)
    matrix[:3, 2] = back
    matrix[:3, :3] *= scale
    matrix[:3, 3] = offset, -offset, offset
    size = 2 * np.tan(np.radians(fov) / 2) if kind == "PERSP" else fov
    return Camera(
        kind, *referential(matrix), window(size, "AUTO", (1920, 1080)), *clip, (1920, 1080)
    )


def _spread(
    camera: Camera,
    radii: Sequence[float] = (0.4, 1.0, 2.5),
    count: int = 4000,
    bounds: tuple[float, ...] = (),
) -> Maker:
    def make(random: np.random.Generator) -> SpheresInView:
        radius = np.array(radii, np.float64)
        group = random.integers(len(radius), size=count, dtype=np.uint8)
        return SpheresInView(camera, scatter(camera, radius[group], random), radius, group, bounds)

    return make


def _at(camera: Camera, points: npt.ArrayLike, radius: float = 1.0) -> Maker:
    def make(_random: np.random.Generator) -> SpheresInView:
        where = np.asarray(points, np.float64).reshape(-1, 3)
        return SpheresInView(camera, where, np.array([radius]), np.zeros(len(where), np.uint8))

    return make


def _plain(count: int) -> Maker:
    def make(random: np.random.Generator) -> SpheresInView:
        points = np.zeros((count, 3))
        points[:, :2] = random.uniform(-500, 500, (count, 2))
        return SpheresInView(
            camera_of(clip=(0.1, 300.0)), points, np.ones(1), np.zeros(count, np.uint8)
        )

    return make


def _lost(axis: int) -> Maker:
    def make(random: np.random.Generator) -> SpheresInView:
        spheres = _spread(camera_of())(random)
        spheres.points[[4, 7, 90], axis] = np.nan, np.inf, -np.inf
        return spheres

    return make


def _axes(far: float) -> Camera:
    """Return a 90-degree square camera at the origin along +y, with exact numbers."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    square = window(2.0, "AUTO", (1000, 1000))
    return Camera("PERSP", *referential(matrix), square, 1.0, far, (1000, 1000))


def cases(most: int) -> dict[str, Maker]:
    """Return the cases of culling by name; each is made when it is asked for, as some are large.

    most: agents of the largest.
    """
    steps = [
        (x, y, z)
        for y in (1.0, 10.0, 15.0, 40.0, 100.0)
        for x in (-y, y, 0.0)
        for z in (-y, y, 0.0)
    ]
    on_planes = [(0, 0, 0), (0, 101, 0), *((x, y, 0) for y in (10.0, 50.0) for x in (-y, y))]
    inside = [(0, 0, 0), (0.5, 0, 0), (0, -0.99, 0), (0, -1.2, 0)]
    tiny = 5e-324 * np.array([[1, 1, 1], [3, 2, 0], [0, 7, 1], [-1, 1e10, 2]])
    one_point = np.tile([[9.0, 27.0, -6.0]], (5000, 1))
    unit = {
        f"unit scale {scale:g}": _spread(
            camera_of(clip=(0.1 * scale, 100.0 * scale)),
            radii=tuple(scale * r for r in (0.4, 1.0, 2.5)),
        )
        for scale in (1e-3, 1e3)
    }
    return {
        **{f"world offset {o:.0e} m": _spread(camera_of(offset=o)) for o in (1e4, 1e6, 1e8)},
        "near to far 1 : 1e9": _spread(camera_of(clip=(1.0, 1e9))),
        "clip 1e-6 to 1e9 m": _spread(camera_of(clip=(1e-6, 1e9))),
        **{
            f"field of view {fov:g} degrees": _spread(camera_of(fov=fov))
            for fov in (1e-5, 0.01, 179.9, 179.99)
        },
        "orthographic": _spread(camera_of(40.0, kind="ORTHO")),
        "orthographic at 1e6 m": _spread(camera_of(40.0, offset=1e6, kind="ORTHO")),
        "panoramic": _spread(camera_of(kind="PANO")),
        "negative scale": _spread(camera_of(scale=-2.0)),
        **unit,
        "characters of 1 mm": _spread(camera_of(clip=(1e-4, 1.0)), radii=(5e-4,)),
        "characters of 1 km": _spread(camera_of(clip=(0.1, 20_000.0)), radii=(500.0,)),
        "spheres of 1e9 m": _spread(camera_of(), radii=(1e9,)),
        "straight down": _spread(camera_of(direction=(0, 0, -1))),
        "straight up": _spread(camera_of(direction=(0, 0, 1))),
        "camera inside an agent": _at(camera_of(), inside),
        "exactly on planes": _at(_axes(100.0), on_planes),
        "exactly on thresholds": _at(_axes(100.0), steps),
        "equal thresholds": _spread(camera_of(), bounds=(0.0, 0.02, 0.02, 0.02, 0.4)),
        "denormals": _at(replace(camera_of(), near=0.0), tiny, 5e-324),
        **{f"NaN and infinity in {axis}": _lost(k) for k, axis in enumerate("xyz")},
        "one agent": _at(camera_of(), [(3, 9, -2)]),
        "all agents in one point": _at(camera_of(), one_point),
        f"{most:,} agents": _plain(most),
    }


def judge_case(name: str, spheres: SpheresInView) -> Iterator[BoundedError]:
    """Yield what the plan of a case gets wrong: `frame.plan`, as frames run it."""
    frame = _planned(spheres)
    visible, levels, distances = frame.visible, frame.levels, frame.distances
    missed = in_vain = off = 0
    camera = replace(spheres.camera, cone=np.pi)
    reach = frame.trajectory.spheres.reach
    for begin in range(0, len(spheres.points), PART):
        part = slice(begin, begin + PART)
        there = np.flatnonzero(~spheres.lost[part]) + begin
        points, group = spheres.points[there], spheres.group[there]
        size = np.abs(points - camera.origin).sum(axis=1) + np.abs(camera.origin).sum()
        own = reach[group]
        must, _ = find_visible(camera, points, own)
        may, _ = find_visible(camera, points, own * (1 + ROUNDING) + (GRAIN + ROUNDING) * size)
        view = FrameToCull(
            standing_crowd(points, group), camera, np.zeros(len(own)), reach, frame.thresholds
        )
        missed += int((must & ~visible[there]).sum())
        in_vain += int((visible[there] & ~may).sum())
        off += int((levels[there] != exact_levels(view))[visible[there]].sum())
    yield BoundedError(name, "agents missed", missed, 0)
    yield BoundedError(name, "agents kept in vain", in_vain + int(visible[spheres.lost].sum()), 0)
    yield BoundedError(name, "LODs off", off, 0)
    if camera.kind != "PANO":
        off_bound = depth_off(camera, spheres.points[~spheres.lost], distances[~spheres.lost])
        yield BoundedError(name, "distance, of its bound", off_bound, 1)


def _planned(spheres: SpheresInView) -> Frame:
    """Return the plan of the case's frame."""
    sizes = tuple(range(len(POLICY.thresholds) + 1, 0, -1))
    groups = [
        Group(str(number), 0.0, radius, 0.0, 1.0, sizes, sizes, spheres.bounds, spheres.bounds)
        for number, radius in enumerate(spheres.radius.tolist())
    ]
    crowd = standing_crowd(spheres.points, spheres.group)
    placed = Snapshot(crowd.x, crowd.y, crowd.z, group=spheres.group)
    drawn = draw_for(placed, 0, Draw(len(groups), tuple(range(len(groups)))))
    trajectory = _Standing(Points(placed, drawn, 1.0, groups, 1 / 24, "a case"), [crowd], 1)
    policy = POLICY
    if spheres.bounds:
        policy = LevelPolicy((0.0,) * (len(spheres.bounds) - 1), tolerance=1.0)
    return plan(trajectory, spheres.camera, policy, 1.0)


def judged(most: int, seed: int) -> Generator[float, None, list[BoundedError]]:
    """Judge all extreme cases, of plans and of steps; yields the progress, returns the rows.

    most: agents of the largest case.
    seed: other agents of the same cases.
    """
    plans = cases(most)
    steps = stiff_cases.cases(seed)
    rows: list[BoundedError] = []
    for number, (name, make) in enumerate(plans.items()):
        rows += judge_case(name, make(np.random.default_rng(seed)))
        yield (number + 1) / (len(plans) + len(steps))
    for number, case in enumerate(steps):
        rows += [BoundedError(case.name, *found) for found in stiff_cases.judge(case)]
        yield (len(plans) + number + 1) / (len(plans) + len(steps))
    return rows


def table_text(rows: Sequence[BoundedError]) -> str:
    """Return the table as lines of text."""
    lines = [
        (row.case, row.quantity, f"{row.error:.3g}", f"{row.bound:g}", "ok" if row.ok else "WRONG")
        for row in rows
    ]
    return "\n".join(aligned(("case", "quantity", "error", "bound", ""), lines))
