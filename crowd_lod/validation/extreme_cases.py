"""Extreme cases of plans, as a table of pictures: culling and LODs beside exact arithmetic."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..crowd.agents import Group
from ..crowd.bounds import STANDING
from ..culling.camera import GRAIN, Camera, referential, window
from ..format import aligned
from ..frame.frame import Frame, plan
from ..levels.assignment import LevelPolicy
from . import stiff_cases
from .culling_errors import Replayed
from .exact_frustum import depth_off, find_levels, find_visible, scatter, standing_crowd
from .stiff_cases import BoundedError

ROUNDING = 1e-12  # of coordinates, beside GRAIN: what is drawn within it is drawn for rounding
POLICY = LevelPolicy((0.1, 0.15, 0.4, 1.0))
PART = 1_000_000  # agents that are judged at a time
NOT_FINITE = np.nan, np.inf, -np.inf
PIXELS = 1920, 1080


@dataclass(frozen=True)
class PlanCase:
    """A picture that is hard to plan.

    points: (n, 3) world meters; None for 4,000 agents in, around and beside the view.
    radii: meters, of the groups, which are drawn at random.
    bounds: meters by which the LODs of all groups deviate; () for LODs by distance.
    lost: the axis along which some agents are at NaN or infinity; None if nobody is.
    plain: agents that are spread over the ground in place of the points.
    """

    name: str
    camera: Camera
    points: ArrayLike | None = None
    radii: tuple[float, ...] = (0.4, 1.0, 2.5)
    bounds: tuple[float, ...] = ()
    lost: int | None = None
    plain: int = 0

    def agents(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return the agents' places, (n, 3) world meters, and groups, (n,) uint8."""
        if self.plain:
            ground = random.uniform(-500, 500, (self.plain, 2))
            points = np.column_stack([ground, np.zeros(self.plain)])
        elif self.points is None:
            group = random.integers(len(self.radii), size=4000, dtype=np.uint8)
            points = scatter(self.camera, np.array(self.radii)[group], random)
            if self.lost is not None:
                points[[4, 7, 90], self.lost] = NOT_FINITE
            return points, group
        else:
            points = np.array(self.points, np.float64)
        return points, np.zeros(len(points), np.uint8)


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
    matrix[:3, :3] = scale * np.column_stack([side, np.cross(back, side), back])
    matrix[:3, 3] = offset, -offset, offset
    size = 2 * np.tan(np.radians(fov) / 2) if kind == "PERSP" else fov
    return Camera(kind, *referential(matrix), window(size, "AUTO", PIXELS), *clip, PIXELS)


def _axes(far: float) -> Camera:
    """Return a 90-degree square camera at the origin along +y, with exact numbers."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    square = window(2.0, "AUTO", (1000, 1000))
    return Camera("PERSP", *referential(matrix), square, 1.0, far, (1000, 1000))


def cases(most: int) -> list[PlanCase]:
    """Return the cases of plans.

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
    one_point = np.tile([9.0, 27.0, -6.0], (5000, 1))
    usual, square = camera_of(), _axes(100.0)
    lenses: dict[str, dict] = {
        **{f"world offset {meters:.0e} m": {"offset": meters} for meters in (1e4, 1e6, 1e8)},
        "near to far 1 : 1e9": {"clip": (1.0, 1e9)},
        "clip 1e-6 to 1e9 m": {"clip": (1e-6, 1e9)},
        **{f"field of view {fov:g} degrees": {"fov": fov} for fov in (1e-5, 0.01, 179.9, 179.99)},
        "orthographic": {"fov": 40.0, "kind": "ORTHO"},
        "orthographic at 1e6 m": {"fov": 40.0, "kind": "ORTHO", "offset": 1e6},
        "panoramic": {"kind": "PANO"},
        "negative scale": {"scale": -2.0},
        "straight down": {"direction": (0, 0, -1)},
        "straight up": {"direction": (0, 0, 1)},
    }
    sizes = {
        "unit scale 0.001": ((1e-4, 0.1), (4e-4, 1e-3, 2.5e-3)),
        "unit scale 1000": ((100.0, 1e5), (400.0, 1000.0, 2500.0)),
        "characters of 1 mm": ((1e-4, 1.0), (5e-4,)),
        "characters of 1 km": ((0.1, 20_000.0), (500.0,)),
        "spheres of 1e9 m": ((0.1, 100.0), (1e9,)),
    }
    return [
        *(PlanCase(name, camera_of(**lens)) for name, lens in lenses.items()),
        *(PlanCase(name, camera_of(clip=clip), radii=r) for name, (clip, r) in sizes.items()),
        PlanCase("camera inside an agent", usual, inside, (1.0,)),
        PlanCase("exactly on planes", square, on_planes, (1.0,)),
        PlanCase("exactly on thresholds", square, steps, (1.0,)),
        PlanCase("equal thresholds", usual, bounds=(0.0, 0.02, 0.02, 0.02, 0.4)),
        PlanCase("denormals", replace(usual, near=0.0), tiny, (5e-324,)),
        *(PlanCase(f"NaN and infinity in {'xyz'[k]}", usual, lost=k) for k in range(3)),
        PlanCase("one agent", usual, [(3, 9, -2)], (1.0,)),
        PlanCase("all agents in one point", usual, one_point, (1.0,)),
        PlanCase(f"{most:,} agents", camera_of(clip=(0.1, 300.0)), radii=(1.0,), plain=most),
    ]


def judge_plan(case: PlanCase, random: np.random.Generator) -> Iterator[BoundedError]:
    """Yield what the plan of a case gets wrong: `frame.plan`, as frames run it."""
    points, group = case.agents(random)
    frame = _planned(case, points, group)
    camera = replace(case.camera, cone=np.pi)
    is_there = np.isfinite(points).all(axis=1)
    wrong = np.array([0, (frame.visible & ~is_there).sum(), 0])
    for begin in range(0, len(points), PART):
        there = np.flatnonzero(is_there[begin : begin + PART]) + begin
        own = points[there]
        radius = frame.trajectory.spheres.reach[group[there]]
        visible = frame.visible[there]
        size = np.abs(own - camera.origin).sum(axis=1) + np.abs(camera.origin).sum()
        must, _ = find_visible(camera, own, radius)
        may, _ = find_visible(camera, own, radius * (1 + ROUNDING) + (GRAIN + ROUNDING) * size)
        off = frame.levels[there] != find_levels(camera, own, frame.thresholds[group[there]])
        wrong += (must & ~visible).sum(), (visible & ~may).sum(), off[visible].sum()
    names = "agents missed", "agents drawn outside the view", "LODs off"
    for name, count in zip(names, wrong.tolist(), strict=True):
        yield BoundedError(case.name, name, count, 0)
    if camera.kind != "PANO":
        off_bound = depth_off(camera, points[is_there], frame.distances[is_there])
        yield BoundedError(case.name, "distance, of its bound", off_bound, 1)


def _planned(case: PlanCase, points: np.ndarray, group: np.ndarray) -> Frame:
    """Return the plan of the case's frame: of a crowd that stands still."""
    policy = POLICY
    if case.bounds:
        policy = LevelPolicy((0.0,) * (len(case.bounds) - 1), tolerance=1.0)
    sizes = tuple(range(len(POLICY.thresholds) + 1, 0, -1))
    groups = tuple(
        Group(str(number), 0.0, radius, 0.0, 1.0, sizes, sizes, case.bounds, case.bounds)
        for number, radius in enumerate(case.radii)
    )
    crowd = standing_crowd(points, group)
    return plan(Replayed([crowd], groups, STANDING), case.camera, policy, 1.0)


def judged(most: int, seed: int) -> Generator[float, None, list[BoundedError]]:
    """Judge all extreme cases, of plans and of steps; yields the progress, returns the rows.

    most: agents of the largest case.
    seed: other agents of the same cases.
    """
    plans = [partial(judge_plan, case) for case in cases(most)]
    steps = [partial(stiff_cases.judge_steps, case) for case in stiff_cases.cases()]
    rows: list[BoundedError] = []
    for number, judge in enumerate([*plans, *steps]):
        rows += judge(np.random.default_rng(seed))
        yield (number + 1) / (len(plans) + len(steps))
    return rows


def table_text(rows: Sequence[BoundedError]) -> str:
    """Return the table as lines of text."""
    lines = [
        (row.case, row.quantity, f"{row.error:.3g}", f"{row.bound:g}", "ok" if row.ok else "WRONG")
        for row in rows
    ]
    return "\n".join(aligned(("case", "quantity", "error", "bound", ""), lines))
