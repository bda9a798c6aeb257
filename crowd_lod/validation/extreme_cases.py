"""Extreme cases, each with a name, that the culling and the LODs must handle."""

import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..culling.camera import Camera, referential, window
from ..culling.radar import lost, radar
from ..format import aligned
from ..levels.assignment import LevelPolicy, assign, threshold_distances
from .exact_frustum import CullingJudgment, judge_culling, scatter, standing_crowd

# the camera, points (n, 3), radius (G,), group (n,)
Spheres = tuple[Camera, np.ndarray, np.ndarray, np.ndarray]
Maker = Callable[[np.random.Generator], Spheres]
# The largest case is judged in parts.
PART = 1_000_000


@dataclass(frozen=True)
class ExtremeCase:
    """One extreme; made when asked for, as some are large."""

    name: str
    make: Maker


@dataclass(frozen=True)
class Row:
    """A line of the table.

    note: what else the case shows.
    """

    name: str
    verdict: CullingJudgment
    milliseconds: float
    note: str = ""


def camera_of(
    fov: float = 50.0,
    near: float = 0.1,
    far: float = 100.0,
    offset: float = 0.0,
    direction: tuple[float, float, float] = (0.3, 0.9, -0.2),
    kind: str = "PERSP",
) -> Camera:
    """Return a camera, 16 : 9, at (1, -1, 1) x offset that looks in `direction`.

    fov: degrees across; for ORTHO meters.
    near, far: meters.
    """
    back = -np.array(direction, np.float64) / np.linalg.norm(direction)
    side = np.cross((0.0, 1.0, 0.0) if abs(back[2]) > 0.9 else (0.0, 0.0, 1.0), back)
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, 0] = side
    matrix[:3, 1] = np.cross(back, side)
    matrix[:3, 2] = back
    matrix[:3, 3] = offset, -offset, offset
    size = 2 * np.tan(np.radians(fov) / 2) if kind == "PERSP" else fov
    return Camera(
        kind, *referential(matrix), window(size, "AUTO", (1920, 1080)), near, far, (1920, 1080)
    )


def _spread(camera: Camera, radii: Sequence[float] = (0.4, 1.0, 2.5), count: int = 4000) -> Maker:
    def make(random: np.random.Generator) -> Spheres:
        radius = np.array(radii, np.float64)
        group = random.integers(len(radius), size=count, dtype=np.uint8)
        return camera, scatter(camera, radius[group], random), radius, group

    return make


def _at(camera: Camera, points: npt.ArrayLike, radius: float = 1.0) -> Maker:
    def make(_random: np.random.Generator) -> Spheres:
        where = np.asarray(points, np.float64).reshape(-1, 3)
        return camera, where, np.array([radius]), np.zeros(len(where), np.uint8)

    return make


def _plain(count: int) -> Maker:
    def make(random: np.random.Generator) -> Spheres:
        points = np.zeros((count, 3))
        points[:, 0] = random.uniform(-500, 500, count)
        points[:, 1] = random.uniform(-500, 500, count)
        return camera_of(far=300.0), points, np.array([1.0]), np.zeros(count, np.uint8)

    return make


def _axes(far: float) -> Camera:
    """Return a 90-degree square camera at the origin along +y, with exact numbers."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return Camera(
        "PERSP", *referential(matrix), window(2.0, "AUTO", (1000, 1000)), 1.0, far, (1000, 1000)
    )


def cases(most: int = 10_000_000) -> tuple[ExtremeCase, ...]:
    """Return the extreme cases.

    most: agents of the largest.
    """
    steps = [
        (x, y, z)
        for y in (1.0, 10.0, 15.0, 40.0, 100.0)
        for x in (-y, y, 0.0)
        for z in (-y, y, 0.0)
    ]
    on_planes = [(0, 0, 0), (0, 101, 0), *((x, y, 0) for y in (10.0, 50.0) for x in (-y, y))]
    makers = [(f"world offset {o:.0e} m", _spread(camera_of(offset=o))) for o in (1e4, 1e6, 1e8)]
    makers += [("clip 1e-6 to 1e9 m", _spread(camera_of(near=1e-6, far=1e9)))]
    makers += [
        (f"field of view {fov:g} degrees", _spread(camera_of(fov=fov))) for fov in (0.01, 179.9)
    ]
    makers += [("characters of 1 mm", _spread(camera_of(near=1e-4, far=1.0), radii=(5e-4,)))]
    makers += [("characters of 1 km", _spread(camera_of(far=20_000.0), radii=(500.0,)))]
    makers += [
        (
            "camera inside an agent",
            _at(camera_of(), [(0, 0, 0), (0.5, 0, 0), (0, -0.99, 0), (0, -1.2, 0)]),
        )
    ]
    makers += [
        ("straight down", _spread(camera_of(direction=(0, 0, -1)))),
        ("straight up", _spread(camera_of(direction=(0, 0, 1)))),
    ]
    makers += [
        ("exactly on planes", _at(_axes(100.0), on_planes)),
        ("exactly on thresholds", _at(_axes(100.0), steps)),
    ]
    tiny = 5e-324 * np.array([[1, 1, 1], [3, 2, 0], [0, 7, 1], [-1, 1e10, 2]])
    makers += [("denormals", _at(replace(camera_of(), near=0.0), tiny, 5e-324))]
    makers += [("spheres of 1e9 m (huge Delta)", _spread(camera_of(), radii=(1e9,)))]
    makers += [("no agents", _at(camera_of(), [])), ("one agent", _at(camera_of(), [(3, 9, -2)]))]
    makers += [
        ("all agents in one point", _at(camera_of(), np.tile([[9.0, 27.0, -6.0]], (5000, 1))))
    ]
    makers += [
        ("orthographic", _spread(camera_of(40.0, kind="ORTHO"))),
        ("panoramic", _spread(camera_of(kind="PANO"))),
    ]
    makers += [(f"{most:,} agents", _plain(most))]
    return tuple(ExtremeCase(name, make) for name, make in makers)


def table(most: int = 10_000_000, seed: int = 0) -> Iterator[Row]:
    """Yield a row for each case, and one for NaN and infinity.

    Agents at NaN or infinity are refused or dropped.
    """
    for case in cases(most):
        camera, points, radius, group = case.make(np.random.default_rng(seed))
        crowd = standing_crowd(points, group)
        started = clock.perf_counter()
        visible, distance = radar(crowd, camera, np.zeros(len(radius)), radius)
        policy = LevelPolicy((0.1, 0.15, 0.4, 1.0))
        ids = assign(distance, threshold_distances(policy, camera, radius), group)
        spent = 1000 * (clock.perf_counter() - started)
        parts = (slice(begin, begin + PART) for begin in range(0, len(points), PART))
        verdict = sum(
            (judge_culling(camera, points[part], radius, group[part]) for part in parts),
            CullingJudgment(),
        )
        levels = np.bincount(ids[visible], minlength=policy.count)
        yield Row(case.name, verdict, spent, "visible by LOD " + " ".join(f"{n:,}" for n in levels))
    yield _judge_lost(seed)


def _judge_lost(seed: int) -> Row:
    camera, points, radius, group = _spread(camera_of())(np.random.default_rng(seed))
    points[[7, 90, 4]] = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]
    crowd = standing_crowd(points, group)
    lost_agents = np.array([4, 7, 90])
    found = lost(crowd)
    note = f"{len(found):,} of {len(crowd):,} agents are left out, the first is agent {found[0]}"
    started = clock.perf_counter()
    visible, _ = radar(crowd, camera, np.zeros(len(radius)), radius)
    spent = 1000 * (clock.perf_counter() - started)
    placed = np.delete(np.arange(len(points)), lost_agents)
    verdict = judge_culling(camera, points[placed], radius, group[placed])
    return Row("NaN and infinity", replace(verdict, survivors=int(visible.sum())), spent, note)


def table_text(rows: list[Row]) -> str:
    """Return the table as lines of text.

    The column surplus counts agents kept for nothing, without those within roundings of a plane.
    """
    head = (
        "case",
        "agents",
        "visible",
        "survivors",
        "missed",
        "surplus",
        "grazing",
        "depth error",
        "ms",
    )
    lines = []
    for row in rows:
        v = row.verdict
        counts = (
            f"{n:,}"
            for n in (v.pairs, v.visible, v.survivors, v.missed, v.surplus - v.grazing, v.grazing)
        )
        lines.append((row.name, *counts, f"{v.depth_error:.2f}", f"{row.milliseconds:.1f}"))
    return "\n".join(aligned(head, lines))
