"""Loose parts of a mesh: which stay, and that each shows as much as before."""

import numpy as np

from . import settings
from .rasterizer import mask

CELL = 32  # pixels across the mask of a part, with one around it
# From where parts are looked at: the corners of a cube, (d, 2, 3) axes of the pictures.
_towards = np.array([(1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]) / np.sqrt(3)
_right = np.cross((0.0, 0.0, 1.0), _towards) * np.sqrt(1.5)
DIRECTIONS = np.stack([_right, np.cross(_towards, _right)], axis=1)


def within(
    points: np.ndarray,
    part: np.ndarray,
    new_points: np.ndarray,
    new_triangles: np.ndarray,
    collapse_map: np.ndarray,
    target: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bring a mesh of many loose parts to at most `target` triangles.

    Parts become cards of two triangles, the smallest first; where that is not enough, those nearest to others go. The largest part
    stays as it is.

    points: (n, 3), part: (n,) the first point of each one's part: of the source. new_points: (n, 3), new_triangles: (m, 3): the LOD, its
    points numbered as the source's. collapse_map: (n,). Returns new points (n, 3), new triangles (k, 3), collapse_map (n,).
    """
    if len(new_triangles) <= target:
        return new_points, new_triangles, collapse_map
    new_points, collapse_map = new_points.copy(), collapse_map.copy()
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
            collapse_map[own[k]] = corners[((points[own[k], None] - points[corners]) ** 2).sum(axis=2).argmin(axis=1)]
    if excess > 0:
        faces = [faces[k] for k in _spread_out(middle, radius, np.array([len(each) for each in faces]), target)]
    return new_points, np.concatenate(faces), collapse_map


def _card(points: np.ndarray) -> np.ndarray:
    """Two triangles (2, 3), or fewer, in place of a part.

    They lie between the points that reach farthest along the two longest axes of `points` (k, 3).
    """
    off = points - points.mean(axis=0)
    along = off @ np.linalg.eigh(off.T @ off)[1][:, :0:-1]
    (a, b), (c, d) = along.argmin(axis=0), along.argmax(axis=0)
    card = np.array([(a, b, c), (a, c, d)])
    return card[(card != np.roll(card, 1, axis=1)).all(axis=1)]


def _spread_out(middle: np.ndarray, radius: np.ndarray, count: np.ndarray, target: int) -> list[int]:
    """Which parts to keep: the largest, then each time the one farthest from those.

    middle: (p, 3), radius: (p,), of spheres about the parts; count: (p,) their triangles; target: triangles in all.
    Source: Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985.
    """
    kept: list[int] = []
    away, left = radius, target
    while not kept or (count <= left).any():
        kept.append(int(np.where(count <= left, away, -1).argmax() if kept else away.argmax()))
        reach = np.linalg.norm(middle - middle[kept[-1]], axis=1) + radius
        away = np.minimum(away, reach) if len(kept) > 1 else reach
        left -= count[kept[-1]]
        count = np.where(np.arange(len(count)) == kept[-1], target + 1, count)
    return kept


def grown(points: np.ndarray, triangles: np.ndarray, part: np.ndarray, wanted: np.ndarray, most: float) -> np.ndarray:
    """Widen parts that show too little, and return the points (n, 3).

    A part is widened about its middle, along each of its own axes as far as along the others.
    points: (n, 3); triangles: (m, 3); part: (n,) each one's number; wanted: (p,) area that each part should show; most: how far
    a part may be widened.
    """
    count = len(wanted)
    middle = np.stack([np.bincount(part, x, count) for x in points.T], axis=1) / np.bincount(part, minlength=count)[:, None]
    off = points - middle[part]
    spread = [np.bincount(part, off[:, i] * off[:, j], count) for i in range(3) for j in range(3)]
    axes = np.linalg.eigh(np.stack(spread, axis=1).reshape(-1, 3, 3))[1]
    along = np.einsum("nd,ndk->nk", off, axes[part])
    reach = np.zeros((count, 3))  # the shortest first
    np.maximum.at(reach, part, np.abs(along))
    more = wanted / np.maximum(areas(points, triangles, part[triangles[:, 0]], count), 1e-300) - 1
    more[more < settings.CURRENT.parts_lost] = 0
    # as a box grows: (a + d) (b + d) + (b + d) (c + d) + (c + d) (a + d) is 1 + more times ab + bc
    # + ca; of what is flat (b + d) (c + d)
    (a, b, c), flat = reach.T, reach[:, 0] < settings.CURRENT.parts_flat * reach[:, 2]
    square, line, area = np.where(
        flat, (np.ones(count), b + c, b * c), (np.full(count, 3.0), 2 * (a + b + c), a * b + b * c + c * a)
    )
    wider = (np.sqrt(line**2 + 4 * square * area * more) - line) / (2 * square)
    scale = 1 + wider.clip(0, most)[:, None] / np.maximum(reach, settings.CURRENT.parts_flat * reach[:, 2:] + 1e-300)
    return middle[part] + np.einsum("nk,ndk->nd", along * scale[part], axes[part])


def areas(points: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int, cell: int = CELL) -> np.ndarray:
    """The area (count,) of each part's silhouette, in the mean of DIRECTIONS.

    points: (n, 3); triangles: (m, 3); part: (m,) of each triangle, one at least of each part; cell: pixels across a part.
    """
    total, across = np.zeros(count), int(np.ceil(np.sqrt(count)))
    for axes in DIRECTIONS:
        flat = (points @ axes.T)[triangles]
        low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
        np.minimum.at(low, part, flat.min(axis=1))
        np.maximum.at(high, part, flat.max(axis=1))
        size = np.maximum(high - low, 1e-300)
        place = np.stack([np.arange(count) % across, np.arange(count) // across], axis=1)
        at = ((flat - low[part, None]) / size[part, None] * (cell - 2) + 1) + cell * place[part, None]
        covered = mask(at, (across * cell, across * cell)).reshape(across, cell, across, cell).sum(axis=(1, 3)).ravel()
        total += covered[:count] * size.prod(axis=1)
    return total / (cell - 2) ** 2 / len(DIRECTIONS)
