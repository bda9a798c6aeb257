"""LOD meshes by decimation.

fast-simplification makes the many cheap collapses, quadric collapses the last; then the vertices
left are moved until the largest distance to the source is least.
"""

import threading
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import counted
from ..mesh import Mesh, connected_components
from ..progress import finished
from .collapse_choice import Poses, normals_of, quadrics_of
from .edge_collapse import Collapsed, collapse
from .loose_parts import silhouette_areas, widened
from .pose_deformation import Skin
from .surface_fit import NEAR_ENOUGH, SurfaceFit
from .triangle_mesh import constrained_edges, edge_keys, half_edges

# fast-simplification's collapses are cheap, but know nothing of poses. It leaves as many times the
# triangles wanted, and as large a part of the source's beside: the last collapses are chosen
# better.
BULK_MARGIN = 1.1
BULK_PART = 0.04
# triangles that it leaves at least: of a mesh with seams, which it does not know, with poses
BULK_SEAMED = 30_000
BULK_POSED = 60_000
BULK_CARE = 3  # fast-simplification's own default of 7 errs more
# weight of the planes of what it leaves, beside the source's: a flat face keeps its corners
BULK_PLANES = 0.5
# Where a smaller part of the triangles than this is wanted, and nothing moves, seams weigh less: by
# the cube of the ratio of the two.
SEAMS_YIELD = 0.1
SEAMS_POSED = 0.5  # weight of seams in each pose, relative to rest: they add up
# Rounds of moves: samples moved at least, which is the work on a small mesh, and samples moved for
# each of the source's triangles, the work on a large one.
MOVES = 1_100_000
MOVES_EACH = 17
ROUNDS = (1, 40)  # at least and at most
STEPS = 8  # moves in a round
RESAMPLINGS = 3  # times at most that new samples are laid between the others
# Another time follows if this one found a distance as many times larger than the one known.
RESAMPLE_GAIN = 1.1

GRID = 2.0**33  # steps in the mesh's size: a power of two, so that flat stays flat

# fast-simplification keeps its mesh in module-global state: one call at a time.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True, eq=False)
class LodMesh(Mesh):
    """A LOD's mesh, with points as float64, in meters, and triangles as int32.

    source: (k,) intp, the source's point whose weights each takes: the nearest of those that
    collapsed into it.
    """

    source: np.ndarray


def missing_library() -> str | None:
    """A sentence saying what decimation lacks on this machine, or None."""
    try:
        import fast_simplification  # noqa: F401 - imported to see whether it can be
    except ImportError as error:
        return (
            f"LOD meshes need the fast-simplification package ({error}): reinstall the Crowd "
            f"LOD extension from its zip."
        )
    return None


def decimate(*args: Any, **named: Any) -> LodMesh:
    """The mesh with about `ratio` of its triangles, all at once: see `decimating`."""
    return finished(decimating(*args, **named))


def decimating(  # noqa: PLR0913 - what a mesh is decimated by
    mesh: Mesh,
    ratio: float,
    name: str,
    seams: np.ndarray | None = None,
    skin: Skin | None = None,
    effort: float = 1.0,
    weight: np.ndarray | None = None,
) -> Generator[None, None, LodMesh]:
    """Make the mesh with about `ratio` of its triangles; yields between its steps.

    mesh: of n points, in meters; ratio: in (0, 1], 1 gives the mesh itself; name: of the mesh, for
    errors.
    seams: (k, 2) indices of points, edges kept in place as open borders are, such as UV seams.
    skin: how its points move, if they do: the poses count as much as the rest.
    effort: what part of MOVES it may do, as one of a character's meshes.
    weight: (n,), how much the planes at each point count when edges collapse; 1 each if None.

    Returns the LodMesh. Points without a triangle are dropped, open borders at the same points
    become one. Loose parts go, where that shows less than what collapses
    elsewhere, see LooseParts. CrowdError for bad input.
    """
    _check(mesh, ratio, name)
    vertices, triangles = np.unique(mesh.triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    points = mesh.points[vertices].astype(np.float64)
    target = max(1, round(ratio * len(triangles)))
    if target >= len(triangles):
        return LodMesh(points, triangles.astype(np.int32), vertices)
    if problem := missing_library():
        raise CrowdError(problem)
    # Of unit size at the origin, and rounded: neither scale nor place decides which of two like
    # edges goes first.
    low = points.min(axis=0)
    size = float(np.ptp(points, axis=0).max()) or 1.0
    unit = np.round((points - low) / size * GRID) / GRID
    joined, constrained = _join_borders(unit, triangles)
    if seams is not None and len(seams):
        numbers = np.full(max(vertices[-1], np.max(seams)) + 1, -1)
        numbers[vertices] = joined
        constrained = np.concatenate([constrained, _renumber(seams, numbers)])
    whole = _without_flat_and_doubled(joined[triangles])
    if not len(whole):
        return LodMesh(points, triangles.astype(np.int32), vertices)
    solid = np.unique(whole)
    index = _index_of(solid, len(unit))
    whole = index[whole]
    constrained = _renumber(constrained, index)
    skin = skin and skin.of(vertices[solid]).scaled(low, size).telling(whole)
    yield
    # of points that became one the greatest weight counts
    weights = np.zeros(len(unit))
    np.maximum.at(weights, joined, 1.0 if weight is None else weight[vertices])
    best = yield from _best(
        Mesh(unit[solid], whole), constrained, target, skin, effort, weights[solid]
    )
    source = solid[best.follows] if skin else _stand_for(unit, best, index[joined])
    return LodMesh(best.points * size + low, best.triangles.astype(np.int32), vertices[source])


def _check(mesh: Mesh, ratio: float, name: str) -> None:
    """Raise CrowdError if `decimating` cannot work with the input."""
    if not 0 < ratio <= 1:
        raise CrowdError(f"The LOD ratio {ratio:g} of {name} is not in (0, 1].")
    if not len(mesh.triangles):
        raise CrowdError(
            f"The mesh {name} has no faces: remove it from its character group or give it some."
        )
    if not np.isfinite(mesh.points).all():
        wrong = int((~np.isfinite(mesh.points)).any(axis=1).sum())
        raise CrowdError(
            f"The mesh {name} has {counted(wrong, 'vertex', 'vertices')} at NaN or infinity."
        )


def _best(
    mesh: Mesh,
    seams: np.ndarray,
    target: int,
    skin: Skin | None,
    effort: float,
    weight: np.ndarray,
) -> Generator[None, None, Collapsed]:
    """Collapse edges, then fit the surface; yields between the steps.

    mesh: of unit size, with n points.
    seams: (k, 2).
    target: triangles wanted.
    effort: part of MOVES.
    weight: (n,), see decimating().
    Returns the points left; `follows` tells something with a skin only.

    Work is counted, not timed: the same mesh gives the same LOD. fast-simplification knows no
    poses, and takes the rings of a straight elbow first: it goes less far, in the pose that bends
    most.
    """
    points = mesh.points
    triangles = mesh.triangles
    part = connected_components(len(points), triangles)
    constrained = constrained_edges(triangles, seams, len(points))
    left = yield from _collapse(mesh, part, seams, constrained, target, skin, weight)
    kept_points, new_triangles = np.unique(left.triangles, return_inverse=True)
    collapse_map = _index_of(kept_points, len(left.points))[left.collapse_map]
    yield
    sides, is_border = constrained
    inner = half_edges(triangles)[sides[~is_border]]  # open borders may move along themselves
    inside = np.isin(edge_keys(seams.T, len(points)), edge_keys(inner.T, len(points)))
    lod = Mesh(left.points[kept_points], new_triangles.reshape(-1, 3))
    fit = SurfaceFit(lod, mesh, collapse_map, seams[inside], skin, left.follows[kept_points])
    yield from _fitted(fit, max(effort * MOVES, MOVES_EACH * len(triangles)))
    return Collapsed(
        _as_wide_as_source(points, triangles, part, fit),
        fit.corners.T,
        fit.copies.originals(fit.collapse_map),
        fit.follows,
    )


def _collapse(  # noqa: PLR0913 - what a mesh is decimated by
    mesh: Mesh,
    part: np.ndarray,
    seams: np.ndarray,
    constrained: tuple[np.ndarray, np.ndarray],
    target: int,
    skin: Skin | None,
    weight: np.ndarray,
) -> Generator[None, None, Collapsed]:
    """Collapse edges until `target` triangles are left; yields between the steps.

    part: (n,), the loose part of each point; constrained: see constrained_edges(); all else: see
    _best().
    """
    points = mesh.points
    triangles = mesh.triangles
    seam_weight = 1.0 if skin else min(1.0, target / len(triangles) / SEAMS_YIELD) ** 3
    facing = normals_of(points, triangles)
    quadrics = quadrics_of(points, triangles, constrained, seam_weight)
    pose_quadrics = [
        quadrics_of(place, triangles, constrained, SEAMS_POSED)
        for place in (skin.place if skin else ())
    ]
    for rows in (quadrics, *pose_quadrics):
        rows[:10] *= weight  # not the area, by which errors are divided
    spared = BULK_POSED if skin else BULK_SEAMED if len(seams) else 0
    yield
    most = max(int(BULK_MARGIN * target + BULK_PART * len(triangles)), spared)
    start, coarse, collapse_map = _bulk(
        points, triangles, part, most, skin.place[0] if skin else points
    )
    yield
    sums, *pose_quadrics = (
        np.stack([np.bincount(collapse_map, row, len(start)) for row in rows])
        for rows in ((*quadrics, *facing.T), *pose_quadrics)
    )
    poses = Poses(skin, pose_quadrics) if skin else None
    if len(coarse) < len(triangles) and not poses:
        # of a flat face all points may have landed far from its corners, which must not forget it
        sums[:11] += BULK_PLANES * quadrics_of(
            start, coarse, constrained_edges(coarse, collapse_map[seams], len(start)), seam_weight
        )
    left = yield from collapse(Mesh(start, coarse), sums[:11], sums[11:].T, target, poses)
    return left._replace(collapse_map=left.collapse_map[collapse_map])


def _index_of(numbers: np.ndarray, n: int) -> np.ndarray:
    """Where each of n points comes among `numbers` (k,), -1 where it does not, (n,)."""
    index = np.full(n, -1)
    index[numbers] = np.arange(len(numbers))
    return index


def _renumber(edges: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Edges (k, 2) by the new `numbers` (n,) of points, without those that have a point of -1."""
    edges = numbers[edges]
    return edges[(edges >= 0).all(axis=1)]


def _fitted(fit: SurfaceFit, moves: float) -> Iterator[None]:
    """Move the LOD nearer to its source, then also what lies between the samples.

    moves: how many samples to move in all, about. Yields between the rounds.
    """
    for k in range(int(np.clip(np.round(moves / (STEPS * fit.samples)), *ROUNDS))):
        if k % 4 == 2:
            fit.flip()
        fit.move(STEPS)
        if fit.worst < NEAR_ENOUGH:
            break
        yield
    fit.restore()
    for _ in range(RESAMPLINGS):
        before = fit.worst
        if before < NEAR_ENOUGH or not fit.add_source_samples() | fit.add_lod_samples():
            break
        resampled = fit.worst
        fit.move(STEPS)
        fit.restore()
        if resampled < RESAMPLE_GAIN * before:
            break


def _as_wide_as_source(
    points: np.ndarray, triangles: np.ndarray, part: np.ndarray, fit: SurfaceFit
) -> np.ndarray:
    """The LOD's points (k, 3) at rest, its loose parts widened if there are several.

    Each part is as wide as it must be to show as much as the source's: points (n, 3), triangles (m,
    3), part (n,).
    """
    new_points = fit.points.T / fit.copies.rest
    if (part[triangles[:, 0]] == part[triangles[0, 0]]).all():
        return new_points
    names, of = np.unique(part[fit.follows], return_inverse=True)
    shown = triangles[np.isin(part[triangles[:, 0]], names)]
    wanted = silhouette_areas(points, shown, np.searchsorted(names, part[shown[:, 0]]), len(names))
    return widened(new_points, fit.corners.T, of, wanted, fit.worst)


def _bulk(
    points: np.ndarray, triangles: np.ndarray, part: np.ndarray, target: int, guide: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """About `target` triangles by fast-simplification.

    points: (n, 3); triangles: (m, 3); part: (n,); guide: (n, 3), the points by which it chooses
    what to collapse. Loose parts that it would lose, or whose faces it would open, double or join,
    stay as they are.
    Returns points (n, 3), triangles, collapse_map (n,).
    """
    import fast_simplification

    n = len(points)
    every = np.arange(len(points))
    if target >= len(triangles):
        return points, triangles, every
    faces = np.ascontiguousarray(triangles, np.int32)
    care = BULK_CARE
    with _one_at_a_time:
        _, _, collapses = fast_simplification.simplify(
            guide, faces, target_count=target, agg=care, return_collapses=True
        )
        new_points, new_triangles, collapse_map = fast_simplification.replay_simplification(
            points, faces, collapses
        )
    # it numbers the points anew: each takes back the number of the first that landed on it
    _, first = np.unique(collapse_map, return_index=True)
    if len(first) != len(new_points) or (collapse_map[first] != np.arange(len(first))).any():
        return points, triangles, every
    moved = points.copy()
    moved[first] = new_points
    new_triangles = first[new_triangles]
    collapse_map = first[collapse_map]
    whole = _without_flat_and_doubled(new_triangles)
    count, sound = (np.bincount(part[each[:, 0]], minlength=n) for each in (new_triangles, whole))
    bad = (count == 0) | (sound < count) | (_uneven(new_triangles, part) > _uneven(triangles, part))
    # where planes hardly differ it may throw a point far away
    low = np.full((n, 3), np.inf)
    high = np.full((n, 3), -np.inf)
    np.minimum.at(low, part, points)
    np.maximum.at(high, part, points)
    bad[part[(np.abs(moved - moved.clip(low[part], high[part])) > 0.01).any(axis=1)]] = True
    bad[part[part[collapse_map] != part]] = True
    bad = bad[part]
    new_triangles = np.concatenate(
        [new_triangles[~bad[new_triangles[:, 0]]], triangles[bad[triangles[:, 0]]]]
    )
    return np.where(bad[:, None], points, moved), new_triangles, np.where(bad, every, collapse_map)


def _uneven(triangles: np.ndarray, part: np.ndarray) -> np.ndarray:
    """How many edges of each part have not two triangles, (n,) at its first point."""
    keys, count = np.unique(edge_keys(half_edges(triangles).T, len(part)), return_counts=True)
    return np.bincount(part[keys[count != 2] // len(part)], minlength=len(part))


def _without_flat_and_doubled(triangles: np.ndarray) -> np.ndarray:
    """The triangles with three different corners, the first of those with the same."""
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    n = int(triangles.max(initial=0)) + 1
    corners = np.sort(triangles, axis=1)
    _, first = np.unique(edge_keys(corners[:, :2].T, n) * n + corners[:, 2], return_index=True)
    return triangles[np.sort(first)]


def _join_borders(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join open borders that lie at the same points, which collapses would part otherwise.

    glTF has such borders along UV seams. Points are not joined where an edge would get more than
    two triangles. points: (n, 3); triangles: (m, 3). Returns the point that each is joined to (n,),
    and the edges (k, 2) that were open.
    """
    n = len(points)
    half = half_edges(triangles)
    joined = np.arange(n)
    _, inverse, count = np.unique(edge_keys(half.T, n), return_inverse=True, return_counts=True)
    border = half[count[inverse] == 1]
    at = np.unique(border)
    if len(at):
        _, first, same = np.unique(points[at], axis=0, return_index=True, return_inverse=True)
        joined[at] = at[first[same.ravel()]]
        _, inverse, count = np.unique(
            edge_keys(joined[half].T, n), return_inverse=True, return_counts=True
        )
        apart = np.isin(joined, joined[half[count[inverse] > 2]])
        joined[apart] = np.flatnonzero(apart)
    return joined, joined[border]


def _stand_for(points: np.ndarray, lod: Collapsed, index: np.ndarray) -> np.ndarray:
    """For each of the LOD's points the nearest of those that collapsed into it, (k,) intp.

    points: (n, 3) of the source; index: (n,) among the points that were collapsed, or -1.
    """
    collapse_map = np.append(lod.collapse_map, -1)[index]
    left = np.flatnonzero(collapse_map >= 0)
    return left[_nearest(points[left], lod.points, collapse_map[left])]


def _nearest(points: np.ndarray, new_points: np.ndarray, collapse_map: np.ndarray) -> np.ndarray:
    """For each new point the nearest of the points that collapsed into it, (k,) intp.

    points: (n, 3); new_points: (k, 3); collapse_map: (n,) the new point of each.
    """
    distance = np.linalg.norm(points - new_points[collapse_map], axis=1)
    order = np.lexsort((distance, collapse_map))
    first = np.searchsorted(collapse_map[order], np.arange(len(new_points)))
    return order[first]
