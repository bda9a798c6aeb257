"""Thin parts of a surface that another one shows from some sides alone.

The Hausdorff distance of two surfaces bounds how far apart their silhouettes are only where both
have a thickness. A rod may become a flat strip within it: no point is farther off than its radius,
but seen edge on the strip covers nothing, and what the picture shows nearest to the rod is where
the strip ends. So where the surface is thinner than the distance could hide, it is asked how much
of the thickness the other one has. Where that is too little, lines of sight along the other surface
tell how far away it shows in the picture, and that distance counts, too.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .triangle_mesh import blocks, ranges

SPACING = 1 / 32  # of the size, between samples of a large triangle at most
# of the deviation: what is thinner is less than half a pixel wide where a LOD of a pixel begins
THIN_LEAST = 0.5
# A LOD must have this part of a thickness. Of half a pixel, 16 samples in a pixel then meet it.
SHOWN = 0.25

PAIRED = 1_000_000  # pairs of samples that are compared at a time
MEASURED = 60  # lost samples, at most, whose pictures are looked at
# along the other surface, and lines of sight about a sample in each
VIEWS = 6
AROUND = 8
GROWTH = 1.2  # of a circle of lines of sight to the next one

# (points (k, 3), directions (k, 3) of unit length) to (k,) meters
Through = Callable[[np.ndarray, np.ndarray], np.ndarray]
# points (k, 3), directions (k, 3) to whether the lines through them meet a surface, (k,) bool
Meets = Callable[[np.ndarray, np.ndarray], np.ndarray]
# points (k, 3) to the points (k, 3) of a surface nearest to them, and the surface's normals (k, 3)
# there, of unit length
Nearest = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Samples:
    """Points of a surface, and how thick it is there.

    at: (n, 3) meters; inwards: (n, 3), against the normal, of unit length; thickness: (n,) meters,
    how long the way inwards is to where it leaves the inside, infinite where it does not.
    through(points, directions): how far it is from points inside the surface, or on it, to where
    they leave the inside.
    """

    at: np.ndarray
    inwards: np.ndarray
    thickness: np.ndarray
    through: Through


def samples(points: np.ndarray, triangles: np.ndarray, through: Through) -> Samples:
    """Sample a surface: points (n, 3) meters; triangles (m, 3), with area; through: see Samples.

    Each triangle has one sample, and large ones have a grid of them, along their longest side. Of
    samples that lie as near to each other and face alike, one is kept.
    """
    spacing = SPACING * float(np.ptp(points, axis=0).max())
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    order = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = (corners[np.arange(len(corners)), order[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    length = sides.max(axis=1)
    along, up = (
        np.ceil(each / spacing).astype(np.intp).clip(1) for each in (length, area / length)
    )
    face = np.repeat(np.arange(len(corners)), along * up)
    number = ranges(np.zeros(len(corners), np.intp), along * up)
    x = ((number % along[face] + 0.5) / along[face])[:, None]
    y = ((number // along[face] + 0.5) / up[face])[:, None]
    foot = np.einsum("md,md->m", c - a, b - a)[face, None] / length[face, None] ** 2
    rising = x / np.maximum(foot, x)
    falling = (1 - x) / (1 - np.minimum(foot, x))
    top = np.where(x < foot, a[face] + rising * (c - a)[face], b[face] + falling * (c - b)[face])
    base = a[face] + x * (b - a)[face]
    at = base + y * (top - base)
    inwards = -(normals / area[:, None])[face]
    cell = np.floor(at / (spacing / 2)).astype(np.intp)
    _, first = np.unique(np.concatenate([cell, inwards > 0], axis=1), axis=0, return_index=True)
    at = at[first]
    inwards = inwards[first]
    return Samples(at, inwards, through(at, inwards), through)


@dataclass
class _Comparison:
    """Which samples of a surface another one does not show from all sides.

    deviation: the Hausdorff distance of the two, meters. normals: (n, 3), of the other surface
    where a sample is narrow along it, else 0; lost: (n,) bool.
    """

    thin: Samples
    nearest: Nearest
    deviation: float

    def __post_init__(self) -> None:
        self.normals = np.zeros_like(self.thin.at)
        self.lost = np.zeros(len(self.thin.at), bool)

    @property
    def most(self) -> float:
        """Thickness in meters from which on the other surface has points on either side of it."""
        return 2 * self.deviation / (1 - SHOWN)

    def look(self, indices: np.ndarray) -> None:
        """Compare thickness at the samples `indices` (k,), both along the other one's normal."""
        thin = self.thin
        normals = self.nearest(thin.at[indices])[1]
        middle = (
            thin.at[indices]
            + np.minimum(thin.thickness[indices], self.most)[:, None] / 2 * thin.inwards[indices]
        )
        with np.errstate(invalid="ignore"):  # where the way inwards never ends
            ends = [
                middle + side * thin.through(middle, side * normals)[:, None] * normals
                for side in (1, -1)
            ]
        ends_inside = np.isfinite(ends).all(axis=(0, 2))
        indices = indices[ends_inside]
        normals = normals[ends_inside]
        ends = [end[ends_inside] for end in ends]
        width, left = (
            np.einsum("kd,kd->k", a - b, normals)
            for a, b in (ends, [self.nearest(end)[0] for end in ends])
        )
        narrow = (width < self.most) & (width > THIN_LEAST * self.deviation)
        self.normals[indices[narrow]] = normals[narrow]
        self.lost[indices[narrow & (left < SHOWN * width)]] = True

    def beside(self, indices: np.ndarray) -> np.ndarray:
        """Which of the samples `indices` (k,) are no farther from a lost one than `most`: (j,)."""
        near = np.full(len(indices), np.inf)
        lost = np.flatnonzero(self.lost)
        for block in blocks(len(lost), max(1, PAIRED // max(len(indices), 1))):
            near = np.minimum(
                near, _squares(self.thin.at[lost[block]], self.thin.at[indices]).min(axis=0)
            )
        return indices[near <= self.most**2]

    def distances(self, meets: Meets) -> tuple[np.ndarray, np.ndarray]:
        """How far in the picture the other surface is from lost samples (k,) meters, and these.

        The views are along the other surface, which covers least in them. Each lost sample's line
        of sight is tried, then circles of lines about it that grow. Returns also the samples'
        places (k, 3), meters.
        """
        lost = np.flatnonzero(self.lost)
        lost = lost[np.linspace(0, len(lost) - 1, min(MEASURED, len(lost))).round().astype(int)]
        normals = self.normals[lost]
        thickness = np.minimum(self.thin.thickness[lost], self.most)[:, None]
        at = self.thin.at[lost] + thickness / 2 * self.thin.inwards[lost]
        side = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(normals, side)
        turns = np.pi * np.arange(VIEWS) / VIEWS
        views = (np.cos(turns)[:, None, None] * side + np.sin(turns)[:, None, None] * up).reshape(
            -1, 3
        )
        at = np.tile(at, (VIEWS, 1))
        normals = np.tile(normals, (VIEWS, 1))
        across = np.cross(views, normals)
        size = float(np.linalg.norm(np.ptp(self.thin.at, axis=0)))
        radius = self.deviation / GROWTH**4
        around = 2 * np.pi * np.arange(AROUND) / AROUND
        waiting = np.flatnonzero(~meets(at, views))
        away = np.zeros(len(at))
        while len(waiting) and radius < size:
            is_shown = np.zeros(len(waiting), bool)
            for turn in around:
                aside = np.cos(turn) * normals[waiting] + np.sin(turn) * across[waiting]
                is_shown |= meets(at[waiting] + radius * aside, views[waiting])
            radius *= GROWTH
            away[waiting] = min(radius, size)
            waiting = waiting[~is_shown]
        return away.reshape(VIEWS, -1).max(axis=0), self.thin.at[lost]


def find_unseen(
    thin: Samples, nearest: Nearest, meets: Meets, deviation: float
) -> tuple[np.ndarray, np.ndarray]:
    """How far thin parts of the surface are, in a picture, from where another surface shows.

    nearest, meets: of the other surface; deviation: the Hausdorff distance of the two, meters.

    The other surface covers least in views along itself. There the widths of both surfaces along
    its normal are compared. Where the surface is thicker than about twice the distance, the other
    has points on either side of its middle, and so shows in all views.

    Returns (k,) meters, and the places (k, 3), of those alone that are farther off than
    `deviation`.
    """
    comparison = _Comparison(thin, nearest, deviation)
    thick = (thin.thickness > comparison.most) | (thin.thickness < THIN_LEAST * deviation)
    comparison.look(np.flatnonzero(~thick))
    if not comparison.lost.any():
        return np.zeros(0), np.zeros((0, 3))
    # the end of a rod is as thick as the rod is long
    comparison.look(comparison.beside(np.flatnonzero(thick)))
    away, places = comparison.distances(meets)
    far = away > deviation
    return away[far], places[far]


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the squared distances (k, j) of points (k, 3) and (j, 3)."""
    return np.sum([(one[:, d, None] - other[:, d]) ** 2 for d in range(3)], axis=0)
