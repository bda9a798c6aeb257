"""Which agents of a frame are judged one by one, and how far LODs may shift their silhouettes."""

from dataclasses import dataclass

import numpy as np

from ..culling.camera import Camera, Window
from ..frame.frame import Frame
from ..frame.planned import OVERRIDDEN, PINNED
from ..levels.assignment import pixels_of

JUDGED = 10  # agents of a frame that are predicted worst, and as many others drawn by chance
SEED = 36
BEYOND = 1.01  # times what is allowed, from which on a pinned agent stands apart
OVERSCAN = 0.5  # parts of the picture by which a crop may reach beyond each of its edges
# why agents stand apart
PINNED_APART = "pinned"
BLURRED_APART = "blurred"
FADING_APART = "in a cross-fade"


@dataclass(frozen=True)
class JudgedAgent:
    """An agent that is rendered alone, at full detail and as it was built.

    level: the LOD that the build shows.
    camera: the eye that is nearest to it.
    window: of that camera, around the agent.
    predicted: pixels by which its LOD shifts its silhouette at most; None if that is not known.
    allowed: pixels that it may shift; None if neither a tolerance nor the prediction is known.
    apart: why `allowed` does not bind it: PINNED_APART, BLURRED_APART or FADING_APART; else "".
    """

    agent: int
    group: int
    level: int
    camera: Camera
    window: Window
    predicted: float | None
    allowed: float | None
    apart: str = ""


@dataclass(frozen=True)
class _Candidates:
    """Agents that a build shows, (m,) each.

    agent, level, eye, group: intp.
    center: (m, 3) meters, of their spheres.
    depth: meters along the view of the nearest eye.
    off: meters, the bound of the LOD; NaN if it is not measured.
    pixels: of that bound, in the middle of the picture; NaN likewise.
    allowed: pixels, likewise; NaN without a tolerance.
    """

    agent: np.ndarray
    level: np.ndarray
    eye: np.ndarray
    group: np.ndarray
    center: np.ndarray
    depth: np.ndarray
    off: np.ndarray
    pixels: np.ndarray
    allowed: np.ndarray


def choose_agents(
    frame: Frame,
    agents: np.ndarray,
    levels: np.ndarray,
    tolerance: float | None,
    number: int,
    count: int = JUDGED,
) -> list[JudgedAgent]:
    """Return the agents of a frame that are rendered alone and judged.

    They are `count` each of: those whose LOD is predicted to shift most, others by chance, and the
    worst of those that stand apart (pinned, blurred or fading). A panoramic camera has none, since
    its pictures have no crops.

    agents: (m,) intp, that the build shows to the camera.
    levels: (m,) intp, their LODs.
    tolerance: pixels that LODs may deviate. None where LODs follow from distances alone: they may
        then deviate as far as their bounds predict.
    number: of the frame; with SEED it fixes the draw.
    """
    if not len(agents) or any(eye.kind == "PANO" for eye in frame.eyes):
        return []
    candidates = _candidates(frame, agents, levels, tolerance)
    apart = _apart(frame, candidates)
    worst_first = np.lexsort((candidates.depth, -np.nan_to_num(candidates.pixels, posinf=np.inf)))
    judged = worst_first[[not apart[k] for k in worst_first]]
    drawn_by_chance = np.random.default_rng((SEED, abs(number))).permutation(judged[count:])
    drawn_by_chance = drawn_by_chance[
        _of_all_kinds(candidates.group[drawn_by_chance], candidates.level[drawn_by_chance])
    ]
    apart_worst_first = worst_first[[bool(apart[k]) for k in worst_first]]
    indices = [
        *judged[:count].tolist(),
        *drawn_by_chance[:count].tolist(),
        *apart_worst_first[:count].tolist(),
    ]
    return [_judged(frame, candidates, k, apart[k]) for k in indices]


def _candidates(
    frame: Frame, agents: np.ndarray, levels: np.ndarray, tolerance: float | None
) -> _Candidates:
    crowd = frame.crowd
    spheres = frame.trajectory.spheres
    groups = frame.trajectory.groups
    group = crowd.group[agents].astype(np.intp)
    center = np.stack(
        [crowd.x[agents], crowd.y[agents], crowd.z[agents] + spheres.center[group]], axis=1
    )
    depths = np.stack([(center - eye.origin) @ eye.Z for eye in frame.eyes])
    eye = np.where(depths > 0, depths, np.inf).argmin(axis=0)
    depth = depths[eye, np.arange(len(agents))]
    table = np.full((len(groups), int(levels.max()) + 1), np.nan)
    for g, bounds in enumerate(each.bounds[: table.shape[1]] for each in groups):
        table[g, : len(bounds)] = bounds
    off = table[group, levels]
    radius = spheres.radius[group]
    pixels = np.empty(len(agents))
    for e, camera in enumerate(frame.eyes):
        pixels[eye == e] = pixels_of(off, depth, camera, radius)[eye == e]
    allowed = np.full(len(agents), np.nan if tolerance is None else tolerance)
    if frame.factors is not None and frame.camera.kind == "PERSP":
        # where less detail is painted, an agent has the LOD of one that is farther away
        farther = frame.factors[agents] * depth - radius
        with np.errstate(divide="ignore", invalid="ignore"):
            allowed *= np.where(depth > radius, np.maximum(farther / (depth - radius), 1.0), 1.0)
    return _Candidates(agents, levels, eye, group, center, depth, off, pixels, allowed)


def _apart(frame: Frame, candidates: _Candidates) -> list[str]:
    """Return for each candidate why it stands apart, "" if it does not."""
    row = np.zeros(len(frame.crowd), np.uint8) if frame.plan_row is None else frame.plan_row
    row = row[candidates.agent]
    pinned = (row & PINNED != 0) & (candidates.pixels > BEYOND * candidates.allowed)
    overridden = pinned & (row & OVERRIDDEN != 0)
    fading = np.zeros(len(candidates.agent), bool)
    if frame.crowd.faded is not None:
        fading = frame.crowd.faded[candidates.agent] < 1
    return np.select(
        [overridden, pinned, fading], [PINNED_APART, BLURRED_APART, FADING_APART], ""
    ).tolist()


def _of_all_kinds(group: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return an order in which every (group, LOD) comes once before any comes twice, (m,) intp."""
    counts: dict[tuple[int, int], int] = {}
    occurrence = []
    for kind in zip(group.tolist(), level.tolist(), strict=True):
        counts[kind] = counts.get(kind, 0) + 1
        occurrence.append(counts[kind])
    return np.argsort(occurrence, kind="stable")


def _judged(frame: Frame, candidates: _Candidates, k: int, apart: str) -> JudgedAgent:
    camera = frame.eyes[candidates.eye[k]]
    group = int(candidates.group[k])
    off = float(candidates.off[k])
    radius = float(frame.trajectory.spheres.radius[group])
    window = window_around(camera, candidates.center[k], radius + np.nan_to_num(off))
    stretch = _stretch(camera, window)
    # the LOD's surface may be nearer to the camera than the character's
    predicted = (
        float(pixels_of(off, candidates.depth[k], camera, radius + off)) * stretch
        if off >= 0
        else np.nan
    )
    allowed = float(candidates.allowed[k]) * stretch
    if predicted > 0 and candidates.pixels[k] > 0:
        allowed *= predicted / stretch / float(candidates.pixels[k])
    if np.isnan(allowed):
        allowed = predicted
    return JudgedAgent(
        agent=int(candidates.agent[k]),
        group=group,
        level=int(candidates.level[k]),
        camera=camera,
        window=window,
        predicted=predicted if np.isfinite(predicted) else None,
        allowed=allowed if np.isfinite(allowed) else None,
        apart=apart,
    )


def _stretch(camera: Camera, window: Window) -> float:
    """Return by what factor a length looks longer at the window's corner than in the middle.

    A point at slope s that moves by e to depth z' moves by (e.XY - s e.Z) / z' in the picture,
    which is sqrt(1 + s^2) |e| / z' at most.
    """
    if camera.kind == "ORTHO":
        return 1.0
    return float(
        np.sqrt(
            1
            + max(abs(window.left), abs(window.right)) ** 2
            + max(abs(window.bottom), abs(window.top)) ** 2
        )
    )


def window_around(camera: Camera, center: np.ndarray, radius: float) -> Window:
    """Return the window of a perspective or orthographic camera that holds a sphere.

    It reaches beyond the picture by OVERSCAN at most.

    center: (3,) meters, world space.
    radius: meters.
    """
    x, y, depth = np.stack([camera.X, camera.Y, camera.Z]) @ (center - camera.origin)
    low = np.array([x - radius, y - radius])
    high = np.array([x + radius, y + radius])
    if camera.kind == "PERSP":
        near = depth - radius
        far = depth + radius
        if near <= 0:
            low = np.full(2, -np.inf)
            high = np.full(2, np.inf)
        else:
            low = np.minimum(low / near, low / far)
            high = np.maximum(high / near, high / far)
    w = camera.window
    least = np.array([w.left, w.bottom])
    most = np.array([w.right, w.top])
    size = most - least
    low = np.clip(low, least - OVERSCAN * size, most)
    high = np.clip(high, least, most + OVERSCAN * size)
    return Window(float(low[0]), float(high[0]), float(low[1]), float(high[1]))
