"""Error against run time: each way to compute a stage, judged and timed.

The judge is exact arithmetic. Rows are flat dicts that share their keys, for CSV and plots. Times
are the median of repeated runs, with least and most.
"""

import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction as F
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ..behavior.exact_walk import walk
from ..behavior.step import step
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..culling.camera import Camera
from ..culling.frustum import frustum_of
from ..culling.radar import RadarOptions, radar
from ..levels.assignment import LevelPolicy, assign, threshold_distances
from ..world.maps import LabelMap
from .exact_behavior import follow_exactly, measure_convergence, measure_drift, step_by_listing
from .exact_frustum import find_visible

MARGINS = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # meters of fixed Delta
# meters by which crowd and camera are moved together, to show what float32 loses far out
OFFSETS = (0.0, 1e5)
LEVEL_OFFSETS = (*OFFSETS, 1e6, 1e7)
SAMPLES = 100  # distances a view that are compared with exact arithmetic
View = tuple[Crowd, tuple[Camera, ...]]
# a step of behavior: crowd, table, map, seconds
Method = Callable[[Crowd, StateMachine, LabelMap, float], Crowd]
# name, precision, meters of a fixed Delta, and the function of a view to a mask (n,) bool
CullingMethod = tuple[str, str, float | None, Callable[[View], np.ndarray]]
Result = TypeVar("Result")


def time_runs(run: Callable[[], object], repeats: int) -> dict[str, float]:
    """Return the median, least and most milliseconds of `repeats` runs.

    The keys are "ms", "ms_least" and "ms_most". One run before them does not count.
    """
    run()
    spent = []
    for _ in range(repeats):
        started = clock.perf_counter()
        run()
        spent.append(1000 * (clock.perf_counter() - started))
    return {"ms": float(np.median(spent)), "ms_least": min(spent), "ms_most": max(spent)}


def map_views(views: Sequence[View], method: Callable[[View], Result]) -> list[Result]:
    """Return the result of the method for each of the views."""
    return [method(view) for view in views]


def thin_out(crowd: Crowd, most: int) -> Crowd:
    """Return the crowd if it has at most `most` agents, else so many, evenly spaced by index."""
    indices = np.linspace(0, len(crowd) - 1, min(len(crowd), most)).round().astype(np.intp)
    return crowd.of(indices)


def compare_behavior(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    frame: float,
    frames: int = 48,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of `step`, `step_by_listing` and the exact walk, each timed and judged.

    The reference is the slow judge. The default of the product is `step`, one step per frame.
    frame: seconds of a frame.
    frames: how many frames the crowd walks. `step` and `step_by_listing` are tried with an eighth
        as many steps to eight times as many. The exact walk is tried frame by frame, and in one go,
        a row whose dt_s is 0.
    ms: per second of the scene.
    """
    seconds = frames * frame
    counts = [max(1, frames * k // 8) for k in (1, 2, 4, 8, 16, 32, 64)]

    def exact_walk(*arguments: Any) -> Crowd:
        return walk(*arguments)[0]

    methods: tuple[tuple[str, Method, list[int]], ...] = (
        ("step", step, counts),
        ("listing", step_by_listing, counts),
        ("exact walk, frame by frame", exact_walk, [frames]),
        ("exact walk", exact_walk, [1]),
    )
    limit = follow_exactly(crowd, machine, world, seconds, limit=True)
    for name, method, step_counts in methods:
        errors_by_step = measure_convergence(crowd, machine, world, limit, step_counts, method)
        for k, count in enumerate(step_counts):

            def run(method: Method = method, count: int = count) -> None:
                moved = crowd
                for _ in range(count):
                    moved = method(moved, machine, world, seconds / count)

            spent = {key: ms / seconds for key, ms in time_runs(run, repeats).items()}
            errors = {
                f"{key}_m": float(getattr(errors_by_step, key)[k])
                for key in ("median", "mean", "worst")
            }
            default = name == "step" and count == frames
            details = {
                "apart": float(errors_by_step.apart[k]),
                "order": errors_by_step.order,
                "agents": errors_by_step.agents,
                "default": int(default),
            }
            dt = 0.0 if name == "exact walk" else seconds / count
            yield {"method": name, "dt_s": dt, **spent, **errors, **details}


def drifts() -> Iterator[dict]:
    """Yield rows of `measure_drift` (exact_behavior.py), for 10,000 to a million steps.

    A row has the precision, meters from the origin, steps, and the mean and worst error in meters.
    """
    for offset in (0.0, 1e4):
        for dtype in (np.float32, np.float64):
            for steps in (10_000, 100_000, 1_000_000):
                mean, worst = measure_drift(dtype, steps, offset=offset)
                yield {
                    "precision": dtype.__name__,
                    "offset_m": offset,
                    "steps": steps,
                    "mean_m": mean,
                    "worst_m": worst,
                }


def pinhole(camera: Camera) -> Camera:
    """Return the camera as validation/exact_frustum.py judges it: planes without any margin.

    Blur and pixel filter add nothing, and a panoramic camera sees in all directions.
    """
    return replace(camera, pad=0.0, turn=0.0, filtered=0.0, cone=np.pi)


def move_view(view: View, offset: float) -> View:
    """Return the view with crowd and cameras moved `offset` meters along x and y."""
    crowd, cameras = view
    shift = np.array([offset, offset, 0.0])
    return replace(crowd, x=crowd.x + offset, y=crowd.y + offset), tuple(
        replace(c, origin=c.origin + shift) for c in cameras
    )


def subtract_origin(
    crowd: Crowd, camera: Camera, center: np.ndarray, way: str
) -> tuple[np.ndarray, ...]:
    """Return v = p - c of the spheres' centers in a way of WAYS: x, y and z, (n,) meters each.

    An experiment for the report alone.
    way: "float32 relative" rounds to float32 after the difference, "float32 world" before it.
    """
    if way == "float32 world":
        return tuple(
            p.astype(np.float32) - np.float32(c)
            for p, c in zip(crowd.places(center), camera.origin, strict=True)
        )
    v = crowd.places(center, origin=camera.origin)
    return tuple(p.astype(np.float32) for p in v) if way == "float32 relative" else v


WAYS = ("float64", "float32 relative", "float32 world")


def cull_by_planes(view: View, center: np.ndarray, radius: np.ndarray, way: str) -> np.ndarray:
    """Return which agents the six planes leave, (n,) bool, without a bound on rounding.

    An experiment for the report alone. Delta is derived from the radii.
    """
    crowd, cameras = view
    mask = np.zeros(len(crowd), bool)
    for camera in cameras:
        v = subtract_origin(crowd, camera, center, way)
        kind = v[0].dtype
        r = radius.astype(v[0].dtype)[crowd.group]
        frustum = frustum_of(camera)
        ok = np.ones(len(crowd), bool)
        for normal, offset in zip(
            frustum.normals.astype(kind), frustum.offsets.astype(kind), strict=True
        ):
            ok &= v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2] <= offset + r
        mask |= ok
    return mask


def compare_culling(
    views: Sequence[View],
    center: np.ndarray,
    radius: np.ndarray,
    margin: float | None = None,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of the culling of all `views`, each timed and judged.

    center, radius: (G,) meters, of the groups' bounding spheres.
    margin: meters of the scene's Delta; its row is marked as the default. None: derived.
    missed, surplus: agents per view, against exact arithmetic.
    ms: per view.
    """
    views = [(crowd, tuple(map(pinhole, cameras))) for crowd, cameras in views]
    exactly = partial(_cull_exactly, center=center, radius=radius)
    for offset in OFFSETS:
        moved_views = [move_view(view, offset) for view in views] if offset else views
        count = len(moved_views)
        truth = map_views(moved_views, exactly)
        for name, precision, delta, method in _culling_methods(
            views, center, radius, margin, offset
        ):
            masks = map_views(moved_views, method)
            pairs = list(zip(truth, masks, strict=True))
            missed = sum(int((visible & ~kept).sum()) for visible, kept in pairs)
            surplus = sum(int((kept & ~visible).sum()) for visible, kept in pairs)
            spent = time_runs(partial(map_views, moved_views, method), repeats)
            is_default = not offset and (
                name == "derived Delta" if margin is None else delta == margin
            )
            yield {
                "method": name,
                "precision": precision,
                "delta_m": "" if delta is None else delta,
                "offset_m": offset,
                **{key: ms / count for key, ms in spent.items()},
                "missed": missed / count,
                "surplus": surplus / count,
                "visible": sum(int(mask.sum()) for mask in truth) / count,
                "default": int(is_default),
            }


def _culling_methods(
    views: Sequence[View],
    center: np.ndarray,
    radius: np.ndarray,
    margin: float | None,
    offset: float,
) -> list[CullingMethod]:
    """Return the ways to cull that are compared, for views moved by `offset` meters.

    Fixed Deltas and exact planes are tried at the origin alone. Panoramic cameras have no planes.
    """
    exactly = partial(_cull_exactly, center=center, radius=radius)
    by_radar = partial(_cull_by_radar, center=center, radius=radius)
    by_planes = partial(cull_by_planes, center=center, radius=radius)
    has_planes = all(camera.kind != "PANO" for _, cameras in views for camera in cameras)
    deltas = MARGINS if margin is None or margin in MARGINS else (*MARGINS, margin)
    methods: list[CullingMethod] = [("derived Delta", "float64", None, by_radar)]
    if has_planes:
        methods += [
            ("six planes, no bound", way, None, partial(by_planes, way=way)) for way in WAYS
        ]
    if has_planes and not offset:
        methods += [
            ("fixed Delta", "float64", delta, partial(by_radar, delta=delta)) for delta in deltas
        ]
    if not offset:
        methods += [("exact planes", "rational", None, exactly)]
    return methods


def _cull_exactly(view: View, center: np.ndarray, radius: np.ndarray) -> np.ndarray:
    crowd, cameras = view
    points = np.stack(crowd.places(center), axis=1)
    return np.logical_or.reduce(
        [find_visible(camera, points, radius[crowd.group])[0] for camera in cameras]
    )


def _cull_by_radar(
    view: View, center: np.ndarray, radius: np.ndarray, delta: float | None = None
) -> np.ndarray:
    return radar(*view, center, radius, RadarOptions(delta))[0]


def exact_thresholds(policy: LevelPolicy, camera: Camera, groups: int) -> list[list[F]]:
    """Return the meters of levels.threshold_distances without rounding, one list per group.

    Tolerance and `finest` of the policy do not count.
    """
    own = dict(enumerate(policy.group_thresholds))
    return [
        [F(float(camera.far)) * F(t) for t in own.get(g) or policy.thresholds]
        for g in range(groups)
    ]


def exact_levels(
    crowd: Crowd, camera: Camera, center: np.ndarray, thresholds: list[list[F]], radial: bool
) -> np.ndarray:
    """Return exact LOD ids, (n,) uint8.

    Rational arithmetic decides for agents whose distance is within float64's bound on rounding of
    a threshold; float64 decides for the others.
    thresholds: meters, from `exact_thresholds`.
    radial: distance from the camera, not along the view.
    """
    v = subtract_origin(crowd, camera, center, "float64")
    distance = (
        np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        if radial
        else v[0] * camera.Z[0] + v[1] * camera.Z[1] + v[2] * camera.Z[2]
    )
    near = np.array([[float(t) for t in row] for row in thresholds])[crowd.group]
    size = sum(map(np.abs, v)) + np.abs(camera.origin).sum()
    ids = (distance[:, None] >= near).sum(axis=1).astype(np.uint8)
    bound = 1e-13 * (size[:, None] + np.abs(near))
    for i in np.flatnonzero((np.abs(distance[:, None] - near) <= bound).any(axis=1)).tolist():
        w = _vector(crowd, camera, center, i)
        along = sum(p * F(float(q)) for p, q in zip(w, camera.Z, strict=True))
        square = sum(p * p for p in w)
        own = thresholds[crowd.group[i]]
        ids[i] = sum(square >= t * t if radial else along >= t for t in own)
    return ids


def _vector(crowd: Crowd, camera: Camera, center: np.ndarray, i: int) -> list[F]:
    """Return v of agent i, exact but for its center's height, added in float64."""
    z = float(crowd.z[i] + center[crowd.group[i]])
    return [
        F(float(p)) - F(float(c))
        for p, c in zip((crowd.x[i], crowd.y[i], z), camera.origin, strict=True)
    ]


def exact_distance(crowd: Crowd, camera: Camera, center: np.ndarray, i: int, radial: bool) -> F:
    """Return the exact distance of agent i in meters; to 40 digits if it is `radial`."""
    v = _vector(crowd, camera, center, i)
    if not radial:
        return sum((p * F(float(q)) for p, q in zip(v, camera.Z, strict=True)), F(0))
    square = sum(p * p for p in v)
    with localcontext() as context:
        context.prec = 40
        return F((Decimal(square.numerator) / Decimal(square.denominator)).sqrt())


def compare_levels(
    views: Sequence[View],
    center: np.ndarray,
    radius: np.ndarray,
    policy: LevelPolicy,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of the distances and LODs of all agents, each timed and judged.

    views: only the first camera of each counts.
    policy: without a tolerance.
    differ, differ_ppm: ids that differ from exact arithmetic, and how many of a million.
    worst_m: the largest error of a distance, meters.
    ms: per view.
    """
    for offset in LEVEL_OFFSETS:
        moved_views = [move_view((crowd, cameras[:1]), offset) for crowd, cameras in views]
        for way in WAYS:
            method = partial(
                distances_and_levels, center=center, radius=radius, policy=policy, way=way
            )
            results = map_views(moved_views, method)
            wrong = 0
            worst = 0.0
            for (crowd, (camera,)), (distance, ids) in zip(moved_views, results, strict=True):
                radial = camera.kind == "PANO"
                truth = exact_levels(
                    crowd, camera, center, exact_thresholds(policy, camera, len(radius)), radial
                )
                wrong += int((ids != truth).sum())
                for i in range(0, len(crowd), max(1, len(crowd) // SAMPLES)):
                    off = F(float(distance[i])) - exact_distance(crowd, camera, center, i, radial)
                    worst = max(worst, abs(float(off)))
            spent = time_runs(partial(map_views, moved_views, method), repeats)
            spent = {key: ms / len(moved_views) for key, ms in spent.items()}
            agents = sum(len(crowd) for crowd, _ in moved_views)
            default = int(way == "float64" and not offset)
            errors = {
                "differ": wrong,
                "of": agents,
                "differ_ppm": 1e6 * wrong / max(agents, 1),
                "worst_m": worst,
            }
            yield {
                "precision": way,
                "offset_m": offset,
                **spent,
                **errors,
                "default": default,
            }


def distances_and_levels(
    view: View, center: np.ndarray, radius: np.ndarray, policy: LevelPolicy, way: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return (distances, LODs) of n agents, found in one `way` of the table of ways.

    center: (3,) meters, of an agent's sphere above its place. radius: (G,) meters, by group.
    Distances: (n,), of the way's dtype. LODs: (n,) integers.
    """
    crowd, (camera,) = view
    x, y, z = subtract_origin(crowd, camera, center, way)
    Z = camera.Z.astype(x.dtype)
    thresholds = threshold_distances(policy, camera, radius).astype(x.dtype)
    radial = camera.kind == "PANO"
    distance = np.sqrt(x * x + y * y + z * z) if radial else x * Z[0] + y * Z[1] + z * Z[2]
    return distance, assign(distance, thresholds, crowd.group)
