"""Loose parts of a mesh, and what becomes of those that there are too few triangles for."""

import numpy as np


def parts_of(n: int, triangles: np.ndarray) -> np.ndarray:
    """For each of n points the first of its loose part, (n,) intp. triangles: (m, 3)."""
    part, before = np.arange(n), None
    while before is None or (part != before).any():
        before = part.copy()
        least = part[triangles].min(axis=1)
        for corner in triangles.T:
            np.minimum.at(part, part[corner], least)
            np.minimum.at(part, corner, least)
        part = part[part]
    return part


def within(points, part, new_points, new_triangles, landed, target: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(new points (n, 3), new triangles (k, 3), landed (n,)) with at most `target` triangles, or those of the largest part: the
    others become cards of two triangles, the smallest first; where that is not enough, those nearest to others go.

    points: (n, 3) of the source; part: (n,) the first point of each one's part; new_points (n, 3), new_triangles (m, 3): the
    LOD, its points numbered as the source's; landed: (n,) the point that each collapsed into.
    """
    if len(new_triangles) <= target:
        return new_points, new_triangles, landed
    new_points, landed = new_points.copy(), landed.copy()
    first, of = np.unique(part[new_triangles[:, 0]], return_inverse=True)
    members = np.flatnonzero(np.isin(part, first))
    members = members[np.argsort(part[members], kind="stable")]
    begin = np.searchsorted(part[members], first)
    low, high = (each.reduceat(points[members], begin) for each in (np.minimum, np.maximum))
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    own, faces = np.split(members, begin[1:]), np.split(np.argsort(of, kind="stable"), np.cumsum(np.bincount(of))[:-1])
    faces = [new_triangles[each] for each in faces]
    excess = len(new_triangles) - target
    for k in np.argsort(radius, kind="stable")[:-1]:
        card = own[k][_card(points[own[k]])] if excess > 0 and len(faces[k]) > 2 else faces[k]
        if 0 < len(card) < len(faces[k]):
            excess -= len(faces[k]) - len(card)
            faces[k], corners = card, np.unique(card)
            new_points[corners] = points[corners]
            landed[own[k]] = corners[((points[own[k], None] - points[corners]) ** 2).sum(axis=2).argmin(axis=1)]
    if excess > 0:
        faces = [faces[k] for k in _spread_out(middle, radius, np.array([len(each) for each in faces]), target)]
    return new_points, np.concatenate(faces), landed


def _card(points: np.ndarray) -> np.ndarray:
    """Triangles (2, 3), or fewer, between the points that reach farthest along the two longest axes of points (k, 3)."""
    off = points - points.mean(axis=0)
    along = off @ np.linalg.eigh(off.T @ off)[1][:, :0:-1]
    (a, b), (c, d) = along.argmin(axis=0), along.argmax(axis=0)
    card = np.array([(a, b, c), (a, c, d)])
    return card[(card != np.roll(card, 1, axis=1)).all(axis=1)]


def _spread_out(middle: np.ndarray, radius: np.ndarray, count: np.ndarray, target: int) -> list[int]:
    """Which parts to keep of spheres about `middle` (p, 3) and of `radius` (p,), of `count` (p,) triangles, `target` in all: the
    largest, then each time the one that reaches farthest from those. Source: Gonzalez, "Clustering to minimize the maximum
    intercluster distance", 1985."""
    kept, away, left = [], radius, target
    while not kept or (count <= left).any():
        kept.append(int(np.where(count <= left, away, -1).argmax() if kept else away.argmax()))
        reach = np.linalg.norm(middle - middle[kept[-1]], axis=1) + radius
        away = np.minimum(away, reach) if len(kept) > 1 else reach
        left -= count[kept[-1]]
        count = np.where(np.arange(len(count)) == kept[-1], target + 1, count)
    return kept
