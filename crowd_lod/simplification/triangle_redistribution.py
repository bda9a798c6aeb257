"""A LOD's triangles moved from where its surface is near the source's to where it is farthest: there sides are split, and as
many triangles collapse elsewhere."""

import numpy as np

from .closest_point import Walkable, distances, length, normals, ranges
from .edge_collapse import FACING, PASSES, bridges, choose, edge_keys, edges_of, held_sides, normals_of, place, quadrics_of
from .surface_fit import Fit, sides_of_two

FAR = 0.7  # of the worst distance: triangles as far off as this are split
LEAD = 0.95  # of it: no collapse may lead farther
MOST = 0.05  # of the triangles may be added at once
TRIED = 2  # collapses tried for each that is needed
CROWDED = 24  # triangles round an edge beyond which none is tried: what that costs grows with their square
UPRIGHT = 0.5  # least cosine between a triangle's normal and those of its halves


def share(fit: Fit) -> None:
    """Split the longest sides of the triangles of `fit` that are farthest off, and collapse as many triangles where that leads
    less far."""
    copies, n, m = fit.copies, fit.lod.points.shape[1], fit.lod.corners.shape[1]
    errors, spare = copies.worst(fit.errors()), _spare(fit)
    halves = _longest(fit, errors, spare)
    added = np.cumsum((halves >= 0).sum(axis=0))
    if not len(added):
        return
    slack = fit.most - len(errors)
    keep, gone, at, freed = _cheapest(fit, errors, halves, added[-1] - slack)
    halves = halves[:, : np.searchsorted(added, freed + slack, side="right")]
    if not halves.shape[1]:
        return
    # from here on in all copies
    fit.follows = fit.follows.copy()
    fit.follows[keep] = follow = copies.nearer(at, fit.follows[keep], fit.follows[gone])
    keep, gone, halves, at = copies.every(keep), copies.every(gone), copies.every(halves), copies.at(at, follow)
    # the edges collapse: went is each point's new index, after each triangle's or -1; stay and alive are those that are left
    points, went, after = fit.lod.points.copy(), np.ones(n, bool), np.full(m, -1)
    points[:, keep] = at
    went[gone] = False
    stay, went = np.flatnonzero(went), np.cumsum(went) - 1
    went[gone] = went[keep]
    corners = went[fit.lod.corners]
    alive = np.flatnonzero((corners != np.roll(corners, 1, axis=0)).all(axis=0))
    after[alive] = np.arange(len(alive))
    seams = went[fit.seams]
    # the sides are split
    halves = np.where(halves >= 0, halves // m * len(alive) + after[halves % m], -1)
    lod, fit.seams, parent = _split(points[:, stay], corners[:, alive], seams[:, seams[0] != seams[1]], halves)
    landed = np.where(fit.landed >= 0, went[fit.landed], -1)
    fit.follows = fit.follows[copies.one(stay)]
    hit = _settle(fit, lod, alive[parent], len(stay), halves, spare, landed)
    changed = np.zeros(lod.points.shape[1], bool)
    changed[went[keep]] = changed[len(stay) :] = True
    changed = changed[lod.corners].any(axis=0)
    # samples go along with their triangles; where these changed they are sought again
    corner, face, weights = went[fit.lod.corner(fit.face, fit.weights)], after[fit.face], fit.weights.copy()
    again = np.flatnonzero((face < 0) | changed[face])
    face[again], weights[:, again] = lod.walk(corner[again], fit.there.take(again, 1))
    g = fit.grid.shape[1]
    every = np.append(np.arange(g * m).reshape(g, m)[:, alive[parent]], g * m + stay)
    fit.lod, fit.landed, fit.face, fit.weights = lod, landed, face, weights
    fit.hit = np.append(fit.hit[every], hit[0])
    fit.hit_weights = np.append(fit.hit_weights.take(every, 1), hit[1], axis=1)
    fit.own_pull = np.append(fit.own_pull[every], np.zeros(len(hit[0])))
    own = fit.spread()
    again = np.flatnonzero(changed[fit.own_face])
    start = fit.source.corner(fit.hit[again], fit.hit_weights.take(again, 1))
    fit.hit[again], fit.hit_weights[:, again] = fit.source.walk(start, own.take(again, 1))
    fit.measure()


def _settle(fit: Fit, lod: Walkable, was, n: int, halves, spare, landed) -> tuple[np.ndarray, np.ndarray]:
    """(triangles, weights) of the source where the points from the n-th on of `lod`, in the middle of the sides `halves`, lie:
    they go there, but for borders and seams, and where that would fold. was: each triangle's index in `fit`. The nearest of the
    source's `spare` points lands on each, in `landed`."""
    points, k, copies = lod.points, halves.shape[1], fit.copies
    new = np.full(fit.lod.corners.shape[1], -1)
    for half in halves:
        new[was[half[half >= 0] % (len(was) - (halves >= 0).sum())]] = np.flatnonzero(half >= 0)
    here = new[fit.face[spare]]
    spare, here = spare[here >= 0], here[here >= 0]
    order = np.lexsort((length(fit.there.take(spare, 1) - points.take(n + here, 1)), here))
    owner = fit.mine[spare[order[np.searchsorted(here[order], np.arange(0, k, copies.count))]]]
    every = copies.every(owner // copies.count)
    landed[every] = np.arange(n, n + k)
    # at rest
    points, corners, first = points[:, :: copies.count], copies.one(lod.corners), n // copies.count
    hit, weights = fit.source.walk(owner, points[:, first:])
    there = points.copy()
    there[:, first:] = fit.source.at(hit, weights)
    before, after = (normals(*(each.take(c, 1) for c in corners)) for each in (points, there))
    folds = np.einsum("dn,dn->n", before, after) < UPRIGHT * length(before) * length(after)
    border = first + np.flatnonzero(copies.one(halves[1]) < 0)
    held = np.concatenate([np.unique(corners[:, folds]), border, copies.one(fit.seams).ravel()])
    there[:, held] = points[:, held]
    fit.follows = np.append(fit.follows, fit.source.corner(hit, weights) // copies.count)
    lod.points = copies.at(there, fit.follows)
    return fit.source.walk(every, lod.points[:, n:])


def _spare(fit: Fit) -> np.ndarray:
    """Which of the source's points in the LOD, as indices into `fit.mine`, are not the nearest at rest of those that landed where
    they did: each point of the LOD keeps one."""
    some = np.flatnonzero(fit.mine % fit.copies.count == 0)
    mine = fit.mine[some]
    landed = fit.landed[mine]
    order = np.lexsort((length(fit.source.points.take(mine, 1) - fit.lod.points.take(landed, 1)), landed))
    spare = np.ones(len(order), bool)
    spare[order[np.searchsorted(landed[order], np.arange(0, fit.lod.points.shape[1], fit.copies.count))]] = False
    return some[spare]


def _longest(fit: Fit, errors: np.ndarray, spare: np.ndarray) -> np.ndarray:
    """The sides to split (2, k), as in sides_of_two(): of one triangle, and of the other or -1: the longest of each triangle
    that is far off, by `errors` (m,), the farthest first; no two of a triangle, and beside each lies a `spare` point."""
    points, corners = fit.points, fit.corners
    m = corners.shape[1]
    one, two, keys = sides_of_two(corners, points.shape[1])
    twin = np.full(3 * m, -1)
    twin[one], twin[two] = two, one
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    single, free = count[inverse] == 1, np.bincount(fit.face[spare] // fit.copies.count, minlength=m) > 0
    far = np.flatnonzero(errors > FAR * fit.worst)
    far = far[np.argsort(-errors[far], kind="stable")]
    long = [length(points.take(corners[i - 1, far], 1) - points.take(corners[i - 2, far], 1)) for i in range(3)]
    taken, halves, left = np.zeros(m, bool), [], max(2, int(MOST * m))
    for side in (np.argmax(long, axis=0) * m + far).tolist():
        other = int(twin[side])
        faces = [side % m] if other < 0 else [side % m, other % m]
        if (other >= 0 or single[side]) and not taken[faces].any() and free[faces].any():
            taken[faces] = True
            halves.append((side, other))
            left -= len(faces)
            if left <= 0:
                break
    return np.array(halves, np.intp).reshape(-1, 2).T


def _cheapest(fit: Fit, errors, halves, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """(the points that stay (k,), those that join them (k,), where (3, k), how many triangles go) of edges to collapse that
    free about `count` triangles: not beside the sides to split, `halves`, and of the cheapest those that lead the least far."""
    copies, points, corners, seams = fit.copies, fit.points, fit.corners, fit.copies.one(fit.seams)
    n, m = points.shape[1], corners.shape[1]
    _, edges, faces = edges_of(corners, n)
    quadrics = quadrics_of(points.T, corners.T, held_sides(corners.T, seams.T, n), fit.hold)
    at, cost = place(points, quadrics, *edges)
    off, busy, seam = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
    for corner in corners:
        np.maximum.at(off, corner, errors)
    busy[corners[:, halves[halves >= 0] % m]] = seam[seams] = True
    off = off[edges].max(axis=0)
    barred = bridges(edges, faces, n) | busy[edges].any(axis=0) | (off > LEAD * fit.worst)
    barred |= seam[edges].any(axis=0) & ~np.isin(edge_keys(edges, n), edge_keys(seams, n))
    barred |= np.diff(fit.lod.first)[edges * copies.count].sum(axis=0) > CROWDED
    cost = np.where(barred, np.inf, cost + (off / 2) ** 2)
    most = min(TRIED * max(count, 4), len(cost))
    order = np.argpartition(cost, most - 1)[:most]
    order = np.sort(order[cost[order] < np.inf])
    follow = copies.nearer(at[:, order], *fit.follows[edges[:, order]])
    there = copies.worst(_after(fit, copies.every(edges[:, order]), copies.at(at[:, order], follow)))
    order = order[np.argsort(there, kind="stable")[: (there < LEAD * fit.worst).sum()]]
    around = normals_of(points.T, corners.T).T
    order, _ = choose(points, corners, around, edges, faces, order, at, PASSES, FACING)
    freed = np.cumsum(faces[order])
    order = order[: np.searchsorted(freed, count) + 1]
    return *edges[:, order], at[:, order], int(faces[order].sum())


def _after(fit: Fit, edges: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The worst distance (k,) at the triangles round each of the edges (2, k) if it collapsed to `at` (3, k)."""
    lod, k = fit.lod, edges.shape[1]
    # an edge's triangles: those of both ends, but for the two between them
    which, face = [], []
    for end in edges:
        count = lod.first[end + 1] - lod.first[end]
        which.append(np.repeat(np.arange(k), count))
        face.append(lod.star[ranges(lod.first[end], count)])
    which, face = np.concatenate(which), np.concatenate(face)
    order = np.argsort(which, kind="stable")
    which, face = which[order], face[order]
    corners = lod.corners.take(face, 1)
    mine = (corners == edges[0, which]) | (corners == edges[1, which])
    # samples on them
    by_face = np.argsort(fit.face, kind="stable")
    first = np.searchsorted(fit.face[by_face], np.arange(lod.corners.shape[1] + 1))
    count = first[face + 1] - first[face]
    sample, of = by_face[ranges(first[face], count)], np.repeat(which, count)
    stays = mine.sum(axis=0) == 1
    which, face, corners, mine = which[stays], face[stays], corners[:, stays], mine[:, stays]
    corner = [np.where(on, at[:, which], lod.points.take(c, 1)) for on, c in zip(mine, corners, strict=True)]
    begin = np.searchsorted(which, np.arange(k + 1))
    count = (begin[1:] - begin[:-1])[of]
    triangle, there = ranges(begin[of], count), np.repeat(fit.there.take(sample, 1), count, axis=1)
    away = distances(there, *(each.take(triangle, 1) for each in corner))
    low = (np.cumsum(count) - count)[count > 0]
    worst = np.zeros(k)
    np.maximum.at(worst, of[count > 0], np.minimum.reduceat(away, low))
    # and to the source from where the edges went, from the new triangles' middles, and from those of their new sides
    turn, every = mine.argmax(axis=0), np.arange(len(which))
    side = (at.take(which, 1) + lod.points.take(corners[turn - 2, every], 1)) / 2
    one = lod.star[lod.first[edges[0]]]
    for of, near, here in ((np.arange(k), one, at), (which, face, sum(corner) / 3), (which, face, side)):
        fine = np.flatnonzero(worst[of] < LEAD * fit.worst)
        some, here = near[fine], here.take(fine, 1)
        start = fit.source.corner(fit.hit[some], fit.hit_weights.take(some, 1))
        np.maximum.at(worst, of[fine], length(here - fit.source.at(*fit.source.walk(start, here))))
    return worst


def _split(points, corners, seams, halves) -> tuple[Walkable, np.ndarray, np.ndarray]:
    """(the mesh, seams, each triangle's own index before) with a point in the middle of each of the sides `halves` (2, k), last
    of all. Of a triangle split one half takes its place, the others come last."""
    n, m = points.shape[1], corners.shape[1]
    new = np.tile(np.arange(n, n + halves.shape[1]), 2)[halves.ravel() >= 0]
    side = halves[halves >= 0]
    a, b, c = (corners[(side // m + k) % 3, side % m] for k in range(3))
    ends = np.stack([b, c])[:, : halves.shape[1]]
    middle = (points.take(ends[0], 1) + points.take(ends[1], 1)) / 2
    corners = np.concatenate([corners, (a, new, c)], axis=1)
    corners[:, side % m] = a, b, new
    keys = edge_keys(ends, n)
    cut, order = np.isin(edge_keys(seams, n), keys), np.argsort(keys)
    which = n + order[np.searchsorted(keys[order], edge_keys(seams[:, cut], n))]
    seams = np.concatenate([seams[:, ~cut], (seams[0, cut], which), (which, seams[1, cut])], axis=1)
    return Walkable(np.concatenate([points, middle], axis=1), corners), seams, np.append(np.arange(m), side % m)
