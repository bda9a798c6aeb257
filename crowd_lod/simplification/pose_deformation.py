"""How a mesh moves in its poses, for decimation to keep what bends."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .triangle_mesh import length

POSES = 3  # besides the one at rest, that decimation heeds
COMPARED = 5_000  # triangles by which poses are compared, about
ALIKE = 1e-3  # mean change of an edge's turn, below which poses are alike
# weight of the three axes, as part of an edge's length: they decide where a vertex's triangles do
# not
AXES = 1e-3
# sizes of the mesh between its copies in the poses, so that no copy is nearest to another
GAP = 2.0
REST_SCALE = 2.0  # how much larger the copy at rest is, so that distances count more there


@dataclass(frozen=True)
class Skin:
    """How points move that are near to those of a mesh.

    A point that moves with the mesh's point i and lies at p at rest lies at place[j, i] + frame[j,
    i] @ (p - rest[i]) in pose j.
    rest: (n, 3) meters; place: (k, n, 3) meters; frame: (k, n, 3, 3), the derivative of the place
    by where it lies at rest.
    """

    rest: np.ndarray
    place: np.ndarray
    frame: np.ndarray

    def at(self, pose: int, points: np.ndarray, follows: np.ndarray) -> np.ndarray:
        """Where points (3, m) at rest lie in the pose, (3, m).

        follows: (m,) the mesh's point that each moves with.
        """
        rows = self._rows[pose].take(follows, 1)
        x, y, z = points - rows[:3]
        return rows[3:6] + (rows[6:9] * x + rows[9:12] * y + rows[12:] * z)

    def nearer(self, points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Of two of the mesh's points the nearer at rest, (m,).

        points: (3, m); a, b: (m,).
        """
        off, off_other = (length(self.rest.T.take(each, 1) - points) for each in (a, b))
        return np.where(off_other < off, b, a)

    def back(self, pose: int, ways: np.ndarray, follows: np.ndarray) -> np.ndarray:
        """Offsets in the pose taken back to rest by the transposed frames, (3, m).

        In the normal equations of least squares they are the right side, `stretch` the left.
        ways: (3, m) offsets, weighed; follows: (m,) what each point moves with.
        """
        x, y, z = ways
        xx, yx, zx, xy, yy, zy, xz, yz, zz = self._rows[pose, 6:].take(follows, 1)
        return np.stack(
            [xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z]
        )

    @cached_property
    def stretch(self) -> np.ndarray:
        """(k, n): how much longer, squared, offsets are in each pose, in the mean."""
        return np.einsum("knij,knij->kn", self.frame, self.frame) / 3

    @cached_property
    def _rows(self) -> np.ndarray:
        """(k, 15, n): rest, place, and the frame's three columns.

        NumPy is several times faster along the long axis.
        """
        frame = self.frame.transpose(0, 3, 2, 1).reshape(len(self.frame), 9, -1)
        rest = np.broadcast_to(self.rest.T, (len(frame), *self.rest.T.shape))
        return np.concatenate([rest, self.place.transpose(0, 2, 1), frame], axis=1)

    def of(self, points: np.ndarray) -> "Skin":
        """That of the mesh's points (m,) alone."""
        return Skin(self.rest[points], self.place[:, points], self.frame[:, points])

    def scaled(self, origin: np.ndarray, size: float) -> "Skin":
        """That of the mesh moved by -origin and divided by size."""
        return Skin((self.rest - origin) / size, (self.place - origin) / size, self.frame)

    def telling(self, triangles: np.ndarray, count: int | None = None) -> "Skin | None":
        """The poses that tell count: each bends the mesh most unlike those before, edge by edge.

        triangles: (m, 3); count: how many, or POSES. None is like the rest or others together.
        Returns None if nothing bends.
        """
        a, b = triangles[:: len(triangles) // COMPARED + 1, [0, 1]].T
        # from one end of a side to the other: what a turn of all together leaves as it is
        turns = np.einsum("kmji,kmjl->kmil", self.frame[:, a], self.frame[:, b]) - np.eye(3)
        unlike = np.sqrt((turns**2).sum(axis=(2, 3)))  # each pose's sides, of the nearest so far
        indices: list[int] = []
        while len(indices) < (count or POSES):
            bent = unlike.mean(axis=1)
            if bent.max(initial=0) < ALIKE:
                break
            # rounding must not decide between two as unlike
            indices.append(int((bent >= (1 - ALIKE) * bent.max()).argmax()))
            off = turns - turns[indices[-1]]
            unlike = np.minimum(unlike, np.sqrt((off**2).sum(axis=(2, 3))))
        return Skin(self.rest, self.place[indices], self.frame[indices]) if indices else None


def frames_of(rest: np.ndarray, place: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The derivatives (k, n, 3, 3) of a mesh whose points move on their own.

    See Skin. By least squares: what the edges of a point's triangles become in each pose, and its
    normal the normal there.
    rest: (n, 3) meters; place: (k, n, 3) meters; triangles: (m, 3).
    """
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    n = len(rest)
    size = np.linalg.norm(rest[ends[:, 1]] - rest[ends[:, 0]], axis=1).mean()

    def vectors(points: np.ndarray) -> np.ndarray:
        """Vectors (s + 4 n, 3) that the derivatives must map.

        The edges from each point, its normal as long as an edge, and a little of each axis, so that
        each point has enough.
        """
        a, b, c = (points[triangles[:, i]] for i in range(3))
        normal = np.zeros((n, 3))
        for corner in triangles.T:
            np.add.at(normal, corner, np.cross(b - a, c - a))
        normal *= size / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        return np.concatenate(
            [
                points[end] - points[start],
                normal,
                *(np.tile(AXES * size * axis, (n, 1)) for axis in np.eye(3)),
            ]
        )

    point = np.concatenate([start, np.tile(np.arange(n), 4)])
    rest_vectors = vectors(rest)

    def products(one: np.ndarray) -> np.ndarray:
        rows = [
            np.bincount(point, one[:, i] * rest_vectors[:, j], n)
            for i in range(3)
            for j in range(3)
        ]
        return np.stack(rows, axis=-1).reshape(n, 3, 3)

    inverse = np.linalg.inv(products(rest_vectors))
    return np.array([products(vectors(at)) @ inverse for at in place])


class Copies:
    """A mesh at rest and in its poses, side by side as one mesh.

    Whatever measures it measures all of them at once. Copy j of point, or triangle, i is number i *
    count + j; the first is at rest, and REST_SCALE times as large if there are others:
    there distances count more.
    """

    def __init__(self, skin: Skin | None):
        self.skin = skin
        self.count = 1 if skin is None else 1 + len(skin.place)
        self.rest = REST_SCALE if self.count > 1 else 1.0
        if skin is not None:
            low = skin.place.min(axis=1)
            high = skin.place.max(axis=1)
            gap = GAP * self.rest * max(np.ptp(skin.rest, axis=0).max(), (high - low).max())
            self.shift = gap * np.arange(1, self.count) - low[:, 0]

    def every(self, numbers: np.ndarray) -> np.ndarray:
        """The numbers (..., k * count) of all copies of `numbers` (..., k), -1 of -1."""
        copies = np.ascontiguousarray(numbers)[..., None] * self.count + np.arange(self.count)
        return np.where(copies < 0, -1, copies).reshape(*numbers.shape[:-1], -1)

    def originals(self, every: np.ndarray) -> np.ndarray:
        """The numbers (..., k) of which `every` (..., k * count) are all copies."""
        return every[..., :: self.count] // self.count

    def worst(self, values: np.ndarray) -> np.ndarray:
        """The greatest (k,) of all copies' `values` (k * count,)."""
        return values.reshape(-1, self.count).max(axis=1)

    def at(self, points: np.ndarray, follows: np.ndarray) -> np.ndarray:
        """All copies (3, k * count) of points (3, k) of the larger copy at rest.

        follows: (k,) what each moves with.
        """
        every = np.empty((3, points.shape[1], self.count))
        every[..., 0] = points
        if self.skin:
            for j in range(1, self.count):
                every[..., j] = self.skin.at(j - 1, points / self.rest, follows)
                every[0, :, j] += self.shift[j - 1]
        return every.reshape(3, -1)

    def joined(
        self, weight: np.ndarray, ways: np.ndarray, follows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The offsets at rest that come nearest to those wanted in all copies.

        weight: (k * count,); ways: (3, k * count), weighed. Returns the weight (k,) and weighed
        offsets (3, k) of the larger copy at rest.
        """
        weight = weight.reshape(-1, self.count)
        ways = ways.reshape(3, -1, self.count)
        total = weight[:, 0].copy()
        way = ways[..., 0].copy()
        if self.skin:
            for j in range(1, self.count):
                total += weight[:, j] * self.skin.stretch[j - 1].take(follows) / self.rest**2
                way += self.skin.back(j - 1, ways[..., j], follows) / self.rest
        return total, way
