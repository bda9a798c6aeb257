"""LOD meshes by decimation (quadric edge collapse, fast-simplification)."""

import threading
from dataclasses import dataclass

import numpy as np

from .collapse import collapse, edge_keys, normals_of, quadrics_of
from .errors import CrowdError
from .refine import fit

BULK = 4  # times the triangles wanted: above that fast-simplification makes the collapses
BULK_AGG = 3  # its aggressiveness then

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


def decimate(points: np.ndarray, triangles: np.ndarray, ratio: float, name: str, seams: np.ndarray | None = None) -> LodMesh:
    """The mesh with about `ratio` of its triangles.

    points: (n, 3) metres; triangles: (m, 3) indices; ratio in (0, 1]; name: of the mesh, for errors; seams: (k, 2) points,
    edges to be kept in place as open borders are, such as UV seams. A ratio of 1 gives the mesh itself. Points without a
    triangle are dropped. Borders that touch at the same points are joined. Each loose part keeps a triangle, or four if
    it is closed; where that is too many, the smallest parts are left out.
    """
    if not 0 < ratio <= 1:
        raise CrowdError(f"The LOD ratio {ratio:g} of {name} is not in (0, 1].")
    if not len(triangles):
        raise CrowdError(f"The mesh {name} has no faces: remove it from its character group or give it some.")
    if not np.isfinite(points).all():
        raise CrowdError(f"The mesh {name} has {int((~np.isfinite(points)).any(axis=1).sum())} vertices at NaN or infinity.")
    used, own = np.unique(triangles, return_inverse=True)
    own = own.reshape(-1, 3)
    target = max(1, round(ratio * len(own)))
    if target >= len(own):
        return LodMesh(points[used].astype(np.float64), own.astype(np.int32), used)
    problem = missing_library()
    if problem:
        raise CrowdError(problem)
    # Unit size about the origin, and rounded: neither scale nor place decides which of two like edges goes first.
    low = points[used].astype(np.float64).min(axis=0)
    size = float(np.ptp(points[used].astype(np.float64), axis=0).max()) or 1.0
    unit = np.round((points[used] - low) / size, 10)
    joined, held = _join_borders(unit, own)
    whole = joined[own]
    whole = whole[(whole != np.roll(whole, 1, axis=1)).all(axis=1)]
    if seams is not None and len(seams):
        index = np.full(len(points), -1)
        index[used] = joined
        held = np.concatenate([held, index[np.asarray(seams)]])
        held = held[(held >= 0).all(axis=1)]
    quadrics, normals = quadrics_of(unit, whole, held), normals_of(unit, whole)
    if BULK * target < len(whole):
        start, begun, landed = _bulk(unit, whole, BULK * target)
        quadrics = np.stack([np.bincount(landed, row, len(unit)) for row in quadrics])
        normals = np.stack([np.bincount(landed, row, len(unit)) for row in normals.T], axis=1)
    else:
        start, begun, landed = unit, whole, np.arange(len(unit))
    new_points, new_triangles, end = collapse(start, begun, quadrics, normals, target)
    landed = end[landed]
    new_triangles = _largest_parts(unit, whole, landed, new_triangles, target)
    kept, new_triangles = np.unique(new_triangles, return_inverse=True)
    new_triangles = new_triangles.reshape(-1, 3)
    here = np.searchsorted(kept, landed[joined])
    here[here == len(kept)] = 0
    stands = kept[here] == landed[joined]
    fitted = fit(new_points[kept], new_triangles, unit[stands], here[stands])
    nearest = np.flatnonzero(stands)[_nearest(unit[stands], fitted, here[stands])]
    return LodMesh(fitted * size + low, new_triangles.astype(np.int32), used[nearest])


def _bulk(points: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points (n, 3), triangles, landed (n,)) by the cheap collapses that fast-simplification makes with care; the mesh
    itself where they would change which edges are open."""
    import fast_simplification

    faces = np.ascontiguousarray(triangles, np.int32)
    with _one_at_a_time:
        _, _, collapses = fast_simplification.simplify(points, faces, target_count=target, agg=BULK_AGG, return_collapses=True)
        some_points, some, landed = fast_simplification.replay_simplification(points, faces, collapses)
    # its points are numbered anew: name each by one of the points that landed on it
    name = np.zeros(len(some_points), np.intp)
    name[landed[::-1]] = np.arange(len(points))[::-1]
    new_points = points.copy()
    new_points[name] = some_points
    landed, some = name[landed], name[some]
    return new_points, some, landed


def _join_borders(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(for each point (n,) the one it is joined to, the edges (k, 2) that join): open borders at the same points become
    one, where then no edge has more than two triangles."""
    n = len(points)
    half = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = edge_keys(half, n)
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    border = half[count[inverse] == 1]
    joined, at = np.arange(n), np.unique(border)
    if len(at):
        _, first, same = np.unique(points[at], axis=0, return_index=True, return_inverse=True)
        joined[at] = at[first[same.ravel()]]
        keys = edge_keys(joined[half], n)
        _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
        apart = np.isin(joined, joined[half[count[inverse] > 2]])
        joined[apart] = np.flatnonzero(apart)
    border = joined[border]
    return joined, border


def _largest_parts(points, triangles, landed, new_triangles, target: int) -> np.ndarray:
    """The new triangles without those of the smallest loose parts, by area, that are too many for `target`."""
    if len(new_triangles) <= target:
        return new_triangles
    part = np.arange(len(points))
    while True:
        lower = part.copy()
        for corner in triangles.T:
            np.minimum.at(lower, corner, part[triangles].min(axis=1))
        lower = lower[lower]
        if (lower == part).all():
            break
        part = lower
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.bincount(part[triangles[:, 0]], np.linalg.norm(np.cross(b - a, c - a), axis=1), len(points))
    part_of = np.empty(len(points), np.intp)
    part_of[landed] = part
    of = part_of[new_triangles[:, 0]]
    order = np.argsort(-area, kind="stable")
    total = np.cumsum(np.bincount(of, minlength=len(points))[order])
    kept = order[(total <= target) | (np.arange(len(order)) == 0)]
    return new_triangles[np.isin(of, kept)]


def _nearest(points: np.ndarray, new_points: np.ndarray, landed: np.ndarray) -> np.ndarray:
    """For each new point the nearest of the points that landed on it, (k,) intp. landed: (n,) index of the new point."""
    distance = np.linalg.norm(points - new_points[landed], axis=1)
    order = np.lexsort((distance, landed))
    first = np.searchsorted(landed[order], np.arange(len(new_points)))
    return order[first]
