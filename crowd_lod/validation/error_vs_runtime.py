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
from ..crowd.maps import LabelMap
from ..crowd.state_machine import StateMachine
from ..culling.camera import Camera
from ..culling.frustum import frustum_of
from ..culling.radar import RadarOptions, radar
from ..levels.assignment import LevelPolicy, assign, limits
from .convergence import convergence, drift, listing
from .exact_behavior import follow_exactly
from .exact_frustum import seen

MARGINS = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # meters of fixed Delta
# meters by which crowd and camera are moved together, to show what float32 loses far out
OFFSETS = (0.0, 1e5)
LEVEL_OFFSETS = (*OFFSETS, 1e6, 1e7)
SAMPLES = 100  # distances a view that are compared with exact arithmetic
View = tuple[Crowd, tuple[Camera, ...]]
# of behavior: a step of so many seconds
Method = Callable[[Crowd, StateMachine, LabelMap, float], Crowd]
Found = TypeVar("Found")


def timed(run: Callable[[], object], repeats: int) -> dict[str, float]:
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


def each(views: Sequence[View], method: Callable[[View], Found]) -> list[Found]:
    """What the method finds in each of the views."""
    return [method(view) for view in views]


def some(crowd: Crowd, most: int) -> Crowd:
    """Return the crowd, or `most` of its agents, evenly taken, if there are more."""
    chosen = np.linspace(0, len(crowd) - 1, min(len(crowd), most)).round().astype(np.intp)
    return crowd.of(chosen)


def behavior(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    frame: float,
    frames: int = 48,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of `step`, `listing` and the exact walk, each timed and judged.

    They run for `frames` frames of `frame` seconds. `step` and `listing` take from an eighth as
    many steps as frames to eight times as many. The exact walk runs frame by frame and in one go,
    whose dt_s is 0. The reference is the slow judge. The default takes one step per frame.
    ms: per second of the scene.
    """
    seconds = frames * frame
    counts = [max(1, frames * k // 8) for k in (1, 2, 4, 8, 16, 32, 64)]

    def exact_walk(*arguments: Any) -> Crowd:
        return walk(*arguments)[0]

    methods: tuple[tuple[str, Method, list[int]], ...] = (
        ("step", step, counts),
        ("listing", listing, counts),
        ("exact walk, frame by frame", exact_walk, [frames]),
        ("exact walk", exact_walk, [1]),
    )
    limit = follow_exactly(crowd, machine, world, seconds, limit=True)
    for name, method, tried in methods:
        found = convergence(crowd, machine, world, limit, tried, method)
        for k, count in enumerate(tried):

            def run(method: Method = method, count: int = count) -> None:
                moved = crowd
                for _ in range(count):
                    moved = method(moved, machine, world, seconds / count)

            spent = {key: ms / seconds for key, ms in timed(run, repeats).items()}
            errors = {
                f"{key}_m": float(getattr(found, key)[k]) for key in ("median", "mean", "worst")
            }
            default = name == "step" and count == frames
            more = {
                "apart": float(found.apart[k]),
                "order": found.order,
                "agents": found.agents,
                "default": int(default),
            }
            dt = 0.0 if name == "exact walk" else seconds / count
            yield {"method": name, "dt_s": dt, **spent, **errors, **more}


def drifts(most: int = 1_000_000) -> Iterator[dict]:
    """Yield rows of `drift` (convergence.py), at most `most` steps each.

    A row has the precision, the meters from the origin, the steps, and the mean and worst error.
    """
    for offset in (0.0, 1e4):
        for dtype in (np.float32, np.float64):
            for steps in (n for n in (10_000, 100_000, 1_000_000) if n <= most):
                mean, worst = drift(dtype, steps, offset=offset)
                yield {
                    "precision": dtype.__name__,
                    "offset_m": offset,
                    "steps": steps,
                    "mean_m": mean,
                    "worst_m": worst,
                }


def pinhole(camera: Camera) -> Camera:
    """Return the camera as validation/exact_frustum.py judges it.

    Without blur and pixel filter; a panoramic one without its cone.
    """
    return replace(camera, pad=0.0, turn=0.0, filtered=0.0, cone=np.pi)


def moved(view: View, offset: float) -> View:
    """Return the view with crowd and cameras moved `offset` meters along x and y."""
    crowd, cameras = view
    shift = np.array([offset, offset, 0.0])
    return replace(crowd, x=crowd.x + offset, y=crowd.y + offset), tuple(
        replace(c, origin=c.origin + shift) for c in cameras
    )


def relative(crowd: Crowd, camera: Camera, center: np.ndarray, way: str) -> tuple[np.ndarray, ...]:
    """Return v = p - c of the spheres' centers: EXPERIMENT, for the report alone.

    Three arrays (n,).
    way: "float64"; "float32 relative" narrows to float32 after the difference, "float32 world"
        before it.
    """
    if way == "float32 world":
        return tuple(
            p.astype(np.float32) - np.float32(c)
            for p, c in zip(crowd.places(center), camera.origin, strict=True)
        )
    v = crowd.places(center, origin=camera.origin)
    return tuple(p.astype(np.float32) for p in v) if way == "float32 relative" else v


WAYS = ("float64", "float32 relative", "float32 world")


def plain(view: View, center: np.ndarray, radius: np.ndarray, way: str) -> np.ndarray:
    """Return (n,) bool, visible by the six planes: EXPERIMENT, for the report alone.

    With the derived Delta, and without a bound on rounding.
    """
    crowd, cameras = view
    mask = np.zeros(len(crowd), bool)
    for camera in cameras:
        v = relative(crowd, camera, center, way)
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


def culling(
    views: Sequence[View],
    center: np.ndarray,
    radius: np.ndarray,
    margin: float | None = None,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of the culling of all `views`, each timed and judged.

    Methods: the derived Delta, fixed ones, exact planes; float32 and float64 without a bound on
        rounding.
    missed, surplus: agents per view, against exact arithmetic.
    ms: per view.
    margin: that of the scene; its row is marked as the default.
    """
    views = [(crowd, tuple(map(pinhole, cameras))) for crowd, cameras in views]

    def exactly(view: View) -> np.ndarray:
        crowd, cameras = view
        points = np.stack(crowd.places(center), axis=1)
        return np.logical_or.reduce(
            [seen(camera, points, radius[crowd.group])[0] for camera in cameras]
        )

    def derived(view: View, delta: float | None = None) -> np.ndarray:
        return radar(*view, center, radius, RadarOptions(delta))[0]

    flat = all(camera.kind != "PANO" for _, cameras in views for camera in cameras)
    fixed = MARGINS if margin is None or margin in MARGINS else (*MARGINS, margin)
    for offset in OFFSETS:
        there = [moved(view, offset) for view in views] if offset else views
        truth = each(there, exactly)
        methods: list[tuple[str, str, float | None, Callable[[View], np.ndarray]]] = [
            ("derived Delta", "float64", None, derived)
        ]
        if flat:
            about = partial(plain, center=center, radius=radius)
            methods += [
                ("six planes, no bound", way, None, partial(about, way=way)) for way in WAYS
            ]
        if not offset:
            methods += (
                [("fixed Delta", "float64", d, partial(derived, delta=d)) for d in fixed]
                if flat
                else []
            )
            methods += [("exact planes", "rational", None, exactly)]
        for name, precision, delta, method in methods:
            masks = each(there, method)
            missed = sum(int((want & ~got).sum()) for want, got in zip(truth, masks, strict=True))
            surplus = sum(int((got & ~want).sum()) for want, got in zip(truth, masks, strict=True))
            spent = timed(partial(each, there, method), repeats)
            spent = {key: ms / len(there) for key, ms in spent.items()}
            default = not offset and (
                name == "derived Delta" if margin is None else delta == margin
            )
            counts = {"missed": missed / len(there), "surplus": surplus / len(there)}
            where = {
                "method": name,
                "precision": precision,
                "delta_m": "" if delta is None else delta,
                "offset_m": offset,
            }
            yield {
                **where,
                **spent,
                **counts,
                "visible": sum(int(t.sum()) for t in truth) / len(there),
                "default": int(default),
            }


def exact_limits(policy: LevelPolicy, camera: Camera, radius: np.ndarray) -> list[list[F]]:
    """Return `limits` of levels/assignment.py without rounding, one list per group.

    PIXELS: for cameras that are not orthographic. Tolerance and `finest` of the policy do not
        count.
    """
    rows = []
    for g, r in enumerate(radius.tolist()):
        own = dict(enumerate(policy.group_thresholds)).get(g) or policy.thresholds
        if policy.metric == "PIXELS":
            rows.append([F(float(camera.pixels_per_unit)) * 2 * F(r) / F(t) for t in own])
        else:
            rows.append([F(float(camera.far)) * F(t) for t in own])
    return rows


def exact_levels(
    crowd: Crowd, camera: Camera, center: np.ndarray, steps: list[list[F]], radial: bool
) -> np.ndarray:
    """Return (n,) uint8: LOD ids, by rational arithmetic where float64 cannot decide.

    Float64 decides where its bound on rounding allows.
    steps: from `exact_limits`.
    radial: distance from the camera, not along the view.
    """
    v = relative(crowd, camera, center, "float64")
    distance = (
        np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        if radial
        else v[0] * camera.Z[0] + v[1] * camera.Z[1] + v[2] * camera.Z[2]
    )
    near = np.array([[float(s) for s in row] for row in steps])[crowd.group]
    size = sum(map(np.abs, v)) + np.abs(camera.origin).sum()
    ids = (distance[:, None] >= near).sum(axis=1).astype(np.uint8)
    bound = 1e-13 * (size[:, None] + np.abs(near))
    for i in np.flatnonzero((np.abs(distance[:, None] - near) <= bound).any(axis=1)).tolist():
        w = _vector(crowd, camera, center, i)
        along = sum(p * F(float(q)) for p, q in zip(w, camera.Z, strict=True))
        square = sum(p * p for p in w)
        ids[i] = sum(square >= s * s if radial else along >= s for s in steps[crowd.group[i]])
    return ids


def _vector(crowd: Crowd, camera: Camera, center: np.ndarray, i: int) -> list[F]:
    """Return v of agent i, exact but for its center's height, added in float64."""
    z = float(crowd.z[i] + center[crowd.group[i]])
    return [
        F(float(p)) - F(float(c))
        for p, c in zip((crowd.x[i], crowd.y[i], z), camera.origin, strict=True)
    ]


def exact_distance(crowd: Crowd, camera: Camera, center: np.ndarray, i: int, radial: bool) -> F:
    """Return the exact distance of agent i; with `radial` to 40 digits."""
    v = _vector(crowd, camera, center, i)
    if not radial:
        return sum((p * F(float(q)) for p, q in zip(v, camera.Z, strict=True)), F(0))
    square = sum(p * p for p in v)
    with localcontext() as context:
        context.prec = 40
        return F((Decimal(square.numerator) / Decimal(square.denominator)).sqrt())


def levels(
    views: Sequence[View],
    center: np.ndarray,
    radius: np.ndarray,
    policies: Sequence[LevelPolicy],
    metric: str,
    repeats: int = 7,
) -> Iterator[dict]:
    """Yield rows of the distances and LODs of all agents, each timed and judged.

    Of each of `views` the first camera counts, with each policy.
    differ, differ_ppm: ids that differ from exact arithmetic, and how many of a million.
    worst_m: the largest error of a distance, meters.
    ms: per view.
    metric: that of the scene; its row is marked as the default.
    """
    for policy in policies:
        kinds = {cameras[0].kind for _, cameras in views}
        if policy.metric == "PIXELS" and "ORTHO" in kinds:
            continue  # one LOD a group, at any distance
        for offset in LEVEL_OFFSETS:
            there = [moved((crowd, cameras[:1]), offset) for crowd, cameras in views]
            for way in WAYS:
                method = partial(_levels, center=center, radius=radius, policy=policy, way=way)
                found = each(there, method)
                wrong = 0
                worst = 0.0
                for (crowd, (camera,)), (distance, ids) in zip(there, found, strict=True):
                    radial = policy.metric == "RADIAL" or camera.kind == "PANO"
                    truth = exact_levels(
                        crowd, camera, center, exact_limits(policy, camera, radius), radial
                    )
                    wrong += int((ids != truth).sum())
                    for i in range(0, len(crowd), max(1, len(crowd) // SAMPLES)):
                        off = F(float(distance[i])) - exact_distance(
                            crowd, camera, center, i, radial
                        )
                        worst = max(worst, abs(float(off)))
                spent = timed(partial(each, there, method), repeats)
                spent = {key: ms / len(there) for key, ms in spent.items()}
                agents = sum(len(crowd) for crowd, _ in there)
                default = int(policy.metric == metric and way == "float64" and not offset)
                errors = {
                    "differ": wrong,
                    "of": agents,
                    "differ_ppm": 1e6 * wrong / max(agents, 1),
                    "worst_m": worst,
                }
                yield {
                    "metric": policy.metric,
                    "precision": way,
                    "offset_m": offset,
                    **spent,
                    **errors,
                    "default": default,
                }


def _levels(
    view: View, center: np.ndarray, radius: np.ndarray, policy: LevelPolicy, way: str
) -> tuple[np.ndarray, np.ndarray]:
    crowd, (camera,) = view
    x, y, z = relative(crowd, camera, center, way)
    Z = camera.Z.astype(x.dtype)
    bounds = limits(policy, camera, radius).astype(x.dtype)
    radial = policy.metric == "RADIAL" or camera.kind == "PANO"
    distance = np.sqrt(x * x + y * y + z * z) if radial else x * Z[0] + y * Z[1] + z * Z[2]
    return distance, assign(distance, bounds, crowd.group)
