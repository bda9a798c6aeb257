"""LOD meshes by decimation.

fast-simplification makes the many cheap collapses, quadric collapses the last; then the vertices
left are moved until the largest distance to the source is least.
"""

import threading
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import counted
from ..mesh import Mesh, connected_components
from ..progress import finished
from .collapse_choice import Poses, normals_of, quadrics_of
from .edge_collapse import Collapsed, Collapsing
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


def decimate(
    mesh: Mesh, ratio: float, *args: Any, weight: np.ndarray | None = None, **named: Any
) -> LodMesh:
    """The mesh with about `ratio` of its triangles, all at once: see Decimation."""
    return finished(Decimation(mesh, *args, **named).lod(ratio, weight))


@dataclass
class _Sequence:
    """Collapses of a mesh, which was kept at each halving of its triangles.

    most: triangles that fast-simplification left; seam_weight, weight: by which edges collapse.
    """

    most: int
    seam_weight: float
    weight: np.ndarray | None
    halvings: list[Collapsing]

    def is_of(self, most: int, seam_weight: float, weight: np.ndarray | None) -> bool:
        """Return whether these are the collapses with the same array of weights, or without."""
        alike = (self.most, self.seam_weight) == (most, seam_weight)
        return alike and self.weight is weight

    def above(self, target: int) -> Generator[None, None, Collapsing]:
        """Return the last halving with enough triangles, to collapse further; yield as it goes.

        Which loose parts go depends on how many triangles are wanted: with some it is the first.
        """
        if self.halvings[0].loose.cheapest < np.inf:
            return self.halvings[0].copy()
        while self.halvings[-1].triangles > 2 * target:
            half = self.halvings[-1].copy()
            count = half.triangles
            yield from half.down_to(count // 4, count // 2)
            if half.stuck:
                break
            self.halvings.append(half)
        return next(each for each in self.halvings[::-1] if each.triangles >= target).copy()


class Decimation:
    """A mesh that LODs are made of.

    Its collapses are one sequence, which all LODs share: the mesh is kept at each halving of its
    triangles, and a LOD goes on from the last that has enough. So it is the same whichever were
    made before.
    """

    def __init__(  # noqa: PLR0913 - what a mesh is decimated by
        self,
        mesh: Mesh,
        name: str,
        seams: np.ndarray | None = None,
        skin: Skin | None = None,
        effort: float = 1.0,
    ):
        """Take a mesh of n points, in meters.

        name: of the mesh, for errors.
        seams: (k, 2) indices of points, edges kept in place as open borders are, such as UV seams.
        skin: how its points move, if they do: the poses count as much as the rest.
        effort: what part of MOVES a LOD may take, as one of a character's meshes.

        Points without a triangle are dropped, open borders at the same points become one.
        CrowdError for bad input.
        """
        _check(mesh, name)
        self.name = name
        self.effort = effort
        self.vertices, triangles = np.unique(mesh.triangles, return_inverse=True)
        self.triangles = triangles.reshape(-1, 3)
        self.points = mesh.points[self.vertices].astype(np.float64)
        # Of unit size at the origin, and rounded: neither scale nor place decides which of two like
        # edges goes first.
        self.low = self.points.min(axis=0)
        self.size = float(np.ptp(self.points, axis=0).max()) or 1.0
        self.unit = np.round((self.points - self.low) / self.size * GRID) / GRID
        joined, border = _join_borders(self.unit, self.triangles)
        if seams is not None and len(seams):
            numbers = np.full(max(self.vertices[-1], np.max(seams)) + 1, -1)
            numbers[self.vertices] = joined
            border = np.concatenate([border, _renumber(seams, numbers)])
        whole = _without_flat_and_doubled(joined[self.triangles])
        self.solid = np.unique(whole)
        index = _index_of(self.solid, len(self.unit))
        self.index = index[joined]
        self.whole = Mesh(self.unit[self.solid], index[whole])
        self.seams = _renumber(border, index)
        self.skin = None
        if skin and len(self.solid):
            of_solid = skin.of(self.vertices[self.solid]).scaled(self.low, self.size)
            self.skin = of_solid.telling(self.whole.triangles)
        self.part = connected_components(len(self.solid), self.whole.triangles)
        self.constrained = constrained_edges(self.whole.triangles, self.seams, len(self.solid))
        self._sequences: dict[bool, _Sequence] = {}  # without weights, and with the last ones

    def lod(self, ratio: float, weight: np.ndarray | None = None) -> Generator[None, None, LodMesh]:
        """Make the LOD of about `ratio` of the triangles; yields between its steps.

        ratio: in (0, 1], 1 gives the mesh itself.
        weight: (n,), how much the planes at each point count when edges collapse; 1 each if None.

        Loose parts go, where that shows less than what collapses elsewhere, see LooseParts.
        CrowdError for a wrong ratio.
        """
        if not 0 < ratio <= 1:
            raise CrowdError(f"The LOD ratio {ratio:g} of {self.name} is not in (0, 1].")
        target = max(1, round(ratio * len(self.triangles)))
        if target >= len(self.triangles) or not len(self.solid):
            return LodMesh(self.points, self.triangles.astype(np.int32), self.vertices)
        if problem := missing_library():
            raise CrowdError(problem)
        left = yield from self._collapsed(target, weight)
        yield
        fit = SurfaceFit(
            Mesh(left.points, left.triangles),
            self.whole,
            left.collapse_map,
            self.seams[self._are_inside()],
            self.skin,
            left.follows,
        )
        yield from _fitted(fit, max(self.effort * MOVES, MOVES_EACH * len(self.whole.triangles)))
        points = self._as_wide_as_source(fit)
        if self.skin:
            source = self.solid[fit.follows]
        else:
            collapse_map = fit.copies.originals(fit.collapse_map)
            source = _stand_for(self.unit, points, np.append(collapse_map, -1)[self.index])
        triangles = fit.corners.T.astype(np.int32)
        return LodMesh(points * self.size + self.low, triangles, self.vertices[source])

    @cached_property
    def _areas(self) -> tuple[np.ndarray, np.ndarray]:
        """The loose parts, (p,) as in `part`, and the areas of their silhouettes, (p,)."""
        triangles = self.whole.triangles
        parts, of = np.unique(self.part[triangles[:, 0]], return_inverse=True)
        return parts, silhouette_areas(self.whole.points, triangles, of, len(parts))

    def _as_wide_as_source(self, fit: SurfaceFit) -> np.ndarray:
        """The LOD's points (k, 3) at rest, its loose parts widened if there are several.

        Each part is as wide as it must be to show as much as the source's.
        """
        points = fit.points.T / fit.copies.rest
        if not self.part.any():
            return points
        parts, areas = self._areas
        left, of = np.unique(self.part[fit.follows], return_inverse=True)
        return widened(points, fit.corners.T, of, areas[np.searchsorted(parts, left)], fit.worst)

    def _are_inside(self) -> np.ndarray:
        """Which seams are no open borders, (k,) bool: these may move along themselves."""
        sides, is_border = self.constrained
        inner = half_edges(self.whole.triangles)[sides[~is_border]]
        n = len(self.solid)
        return np.isin(edge_keys(self.seams.T, n), edge_keys(inner.T, n))

    def _collapsed(
        self, target: int, weight: np.ndarray | None
    ) -> Generator[None, None, Collapsed]:
        """Collapse edges until `target` triangles are left; yields between the steps."""
        count = len(self.whole.triangles)
        spared = BULK_POSED if self.skin else BULK_SEAMED if len(self.seams) else 0
        most = min(max(int(BULK_MARGIN * target + BULK_PART * count), spared), count)
        seam_weight = 1.0 if self.skin else min(1.0, target / count / SEAMS_YIELD) ** 3
        sequence = self._sequences.get(weight is not None)
        if sequence is None or not sequence.is_of(most, seam_weight, weight):
            begun = self._begin(most, seam_weight, weight)
            sequence = _Sequence(most, seam_weight, weight, [begun])
            self._sequences[weight is not None] = sequence
            yield
        left = yield from sequence.above(target)
        yield from left.down_to(target)
        return left.result()

    def _begin(self, most: int, seam_weight: float, weight: np.ndarray | None) -> Collapsing:
        """Return the mesh, of which fast-simplification has left about `most` triangles."""
        points = self.whole.points
        triangles = self.whole.triangles
        facing = normals_of(points, triangles)
        quadrics = quadrics_of(points, triangles, self.constrained, seam_weight)
        pose_quadrics = [
            quadrics_of(place, triangles, self.constrained, SEAMS_POSED)
            for place in (self.skin.place if self.skin else ())
        ]
        # of points that became one the greatest weight counts
        weights = np.zeros(len(self.solid) + 1)  # the last stands for points that are dropped
        np.maximum.at(weights, self.index, 1.0 if weight is None else weight[self.vertices])
        weights = weights[:-1]
        for rows in (quadrics, *pose_quadrics):
            rows[:10] *= weights  # not the area, by which errors are divided
        guide = self.skin.place[0] if self.skin else points
        start, coarse, collapse_map = _bulk(points, triangles, self.part, most, guide)
        sums, *pose_quadrics = (
            np.stack([np.bincount(collapse_map, row, len(start)) for row in rows])
            for rows in ((*quadrics, *facing.T), *pose_quadrics)
        )
        poses = Poses(self.skin, pose_quadrics) if self.skin else None
        if len(coarse) < len(triangles) and not poses:
            # of a flat face all points may have landed far from its corners, which must not forget
            # it
            constrained = constrained_edges(coarse, collapse_map[self.seams], len(start))
            sums[:11] += BULK_PLANES * quadrics_of(start, coarse, constrained, seam_weight)
        begun = Collapsing(Mesh(start, coarse), sums[:11], sums[11:].T, poses)
        begun.collapse_map = begun.collapse_map[collapse_map]
        return begun


def _check(mesh: Mesh, name: str) -> None:
    """Raise CrowdError if no LOD can be made of the mesh."""
    if not len(mesh.triangles):
        raise CrowdError(
            f"The mesh {name} has no faces: remove it from its character group or give it some."
        )
    if not np.isfinite(mesh.points).all():
        wrong = int((~np.isfinite(mesh.points)).any(axis=1).sum())
        raise CrowdError(
            f"The mesh {name} has {counted(wrong, 'vertex', 'vertices')} at NaN or infinity."
        )


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


def _stand_for(points: np.ndarray, new_points: np.ndarray, collapse_map: np.ndarray) -> np.ndarray:
    """For each new point the nearest of the points that collapsed into it, (k,) intp.

    points: (n, 3) of the source; new_points: (k, 3); collapse_map: (n,) the new point of each, or
    -1.
    """
    left = np.flatnonzero(collapse_map >= 0)
    return left[_nearest(points[left], new_points, collapse_map[left])]


def _nearest(points: np.ndarray, new_points: np.ndarray, collapse_map: np.ndarray) -> np.ndarray:
    """For each new point the nearest of the points that collapsed into it, (k,) intp.

    points: (n, 3); new_points: (k, 3); collapse_map: (n,) the new point of each.
    """
    distance = np.linalg.norm(points - new_points[collapse_map], axis=1)
    order = np.lexsort((distance, collapse_map))
    first = np.searchsorted(collapse_map[order], np.arange(len(new_points)))
    return order[first]
