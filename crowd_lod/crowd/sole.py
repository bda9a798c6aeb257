"""The height at which a character stands: that of its soles, whatever hangs lower."""

import numpy as np

from ..connected_components import connected_components

PLANTED = (
    1 / 3
)  # of the poses of an action: in as many a foot may dip below the ground, as where it pushes off
SLAB = 0.02  # of the height: soles are looked for in layers so thick
BEARING = 0.002  # of the height squared: an area that faces down so wide carries the character
EDGE = 0.1  # of the area that carries: a part with less of it does not stand
HANGS = 0.03  # of the surface: what hangs below the soles, such as a sword in the hand, is no more


def ground_of(soles: np.ndarray) -> float:
    """Return the height of the ground on which a character walks, by that of its lowest sole in
    each pose.

    A toe may dip below it where the foot pushes off, and both feet leave it in a run.

    soles: (n,), over an action.
    """
    return float(np.quantile(soles, PLANTED, method="lower"))


def sole_of(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the height of the lowest surface that is wide enough to stand on.

    It is the lowest point's where nothing, or too much of the character, lies below such a surface.
    inf without a point.

    points: (n, 3), z up; triangles: (m, 3) of their indices.
    """
    lowest = float(points[:, 2].min(initial=np.inf))
    height = float(points[:, 2].max(initial=-np.inf)) - lowest
    if not len(triangles) or not 0 < height < np.inf:
        return lowest
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    middle = corners[:, :, 2].mean(axis=1)
    slab = ((middle - lowest) / (SLAB * height)).astype(np.intp)
    down = np.bincount(slab, np.maximum(-normal[:, 2], 0))
    area = np.bincount(slab, np.linalg.norm(normal, axis=1))
    (wide,) = np.nonzero(down + np.append(down[1:], 0) >= BEARING * height**2)
    if not len(wide) or area[: wide[0]].sum() > HANGS * area.sum():
        return lowest
    if wide[0] == 0:
        return lowest
    (low,) = np.nonzero(slab <= wide[0] + 1)
    # importers split the vertices of flat faces: what touches is one part
    _, corner = np.unique(corners[low].reshape(-1, 3), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    part = connected_components(int(corner.max()) + 1, corner)[corner[:, 0]]
    carries = np.where(slab[low] >= wide[0], np.maximum(-normal[low, 2], 0), 0)
    borne = np.bincount(part, carries)
    # a foot that rolls has its sole upright in part, and reaches below what faces down
    stands = low[borne[part] > EDGE * borne.sum()]
    return float(corners[stands, :, 2].min())
