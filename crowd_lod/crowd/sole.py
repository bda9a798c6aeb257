"""The height at which a character stands: that of its soles, though a sword may hang lower."""

import numpy as np

from ..mesh import connected_components

# In this part of an action's poses a foot may dip below the ground, as where it pushes off.
PLANTED = 1 / 3
SLAB = 0.02  # thickness of the layers in which soles are sought, as part of the height
# Surface facing down that carries the character, as part of the height squared.
BEARING = 0.002
EDGE = 0.1  # a loose part stands if it has this part of the area that carries
# Part of the surface that may hang below the soles at most, such as a sword in the hand.
HANGS = 0.03


def ground_of(soles: np.ndarray) -> float:
    """Return the height of the ground on which a character walks.

    soles: (n,), the height of its lowest sole in each pose of an action. A toe may dip below the
        ground where the foot pushes off, and both feet leave it in a run.
    """
    return float(np.quantile(soles, PLANTED, method="lower"))


def sole_of(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the height of the lowest surface that is wide enough to stand on.

    It is the height of the lowest point where no surface is wide enough, or where more than HANGS
    of the character lies below it. inf without a point.

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
