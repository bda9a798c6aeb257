"""LOD meshes by decimation (quadric edge collapse, fast-simplification)."""

import threading
from dataclasses import dataclass

import numpy as np

from .errors import CrowdError

# fast-simplification keeps its mesh in module-global state: one call at a time.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class LodMesh:
    """points: (k, 3) float64, metres; triangles: (m, 3) int32; source: (k,) intp, for each point the nearest of the
    source's points that collapsed into it, whose weights it takes."""

    points: np.ndarray
    triangles: np.ndarray
    source: np.ndarray


def missing_library() -> str | None:
    """A sentence saying what decimation lacks on this machine, or None."""
    try:
        import fast_simplification  # noqa: F401
    except ImportError as error:
        return f"LOD meshes need the fast-simplification package ({error}): reinstall the Crowd LOD extension from its zip."
    return None


def decimate(points: np.ndarray, triangles: np.ndarray, ratio: float, name: str) -> LodMesh:
    """The mesh with about `ratio` of its triangles.

    points: (n, 3) metres; triangles: (m, 3) indices; ratio in (0, 1]; name: of the mesh, for errors. A ratio of 1 gives
    the mesh itself. Points without a triangle are dropped.
    """
    if not 0 < ratio <= 1:
        raise CrowdError(f"The LOD ratio {ratio:g} of {name} is not in (0, 1].")
    if not len(triangles):
        raise CrowdError(f"The mesh {name} has no faces: remove it from its character group or give it some.")
    if not np.isfinite(points).all():
        raise CrowdError(f"The mesh {name} has {int((~np.isfinite(points)).any(axis=1).sum())} vertices at NaN or infinity.")
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    points = points[used].astype(np.float64)
    target = max(4, round(ratio * len(triangles)))
    if target >= len(triangles):
        return LodMesh(points, triangles.astype(np.int32), used)
    problem = missing_library()
    if problem:
        raise CrowdError(problem)
    import fast_simplification

    # The library drops faces far below its default tolerances: a character of 1 mm is brought to unit size and back.
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    with _one_at_a_time:
        unit = np.ascontiguousarray((points - low) / size)
        _, _, collapses = fast_simplification.simplify(
            unit, np.ascontiguousarray(triangles, np.int32), target_count=target, agg=5, return_collapses=True
        )
        new_points, new_triangles, landed = fast_simplification.replay_simplification(
            unit, np.ascontiguousarray(triangles, np.int32), collapses
        )
    if not len(new_triangles):
        return LodMesh(points, triangles.astype(np.int32), used)
    return LodMesh(new_points * size + low, new_triangles.astype(np.int32), used[_nearest(unit, new_points, landed)])


def _nearest(points: np.ndarray, new_points: np.ndarray, landed: np.ndarray) -> np.ndarray:
    """For each new point the nearest of the points that landed on it, (k,) intp. landed: (n,) index of the new point."""
    distance = np.linalg.norm(points - new_points[landed], axis=1)
    order = np.lexsort((distance, landed))
    first = np.searchsorted(landed[order], np.arange(len(new_points)))
    return order[first]
