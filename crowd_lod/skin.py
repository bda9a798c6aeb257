"""How a mesh moves in its poses: what decimation must know to keep the rings of an elbow that is straight at rest."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

MOST = 3  # poses, besides the one at rest, that decimation heeds
LOOKED_AT = 5_000  # triangles that tell poses apart, about
STIFF = 1e-3  # mean change of a side's turn below which poses are alike


@dataclass(frozen=True)
class Skin:
    """A point that moves with the mesh's point i and lies at p at rest lies at place[j, i] + frame[j, i] @ (p - rest[i]) in
    pose j.

    rest: (n, 3) metres; place: (k, n, 3) metres; frame: (k, n, 3, 3), the derivative of the place by where it lies at rest.
    """

    rest: np.ndarray
    place: np.ndarray
    frame: np.ndarray

    def at(self, pose: int, points: np.ndarray, follows: np.ndarray) -> np.ndarray:
        """Where points (3, m) at rest, each moving with the mesh's point `follows` (m,), lie in the pose, (3, m)."""
        rows = self._rows[pose].take(follows, 1)
        x, y, z = points - rows[:3]
        return rows[3:6] + (rows[6:9] * x + rows[9:12] * y + rows[12:] * z)

    @cached_property
    def _rows(self) -> np.ndarray:
        """(k, 15, n): rest, place, and the frame's three columns: NumPy is several times faster along the long axis."""
        frame = self.frame.transpose(0, 3, 2, 1).reshape(len(self.frame), 9, -1)
        rest = np.broadcast_to(self.rest.T, (len(frame), *self.rest.T.shape))
        return np.concatenate([rest, self.place.transpose(0, 2, 1), frame], axis=1)

    def of(self, points: np.ndarray) -> "Skin":
        """That of the mesh's points (m,) alone."""
        return Skin(self.rest[points], self.place[:, points], self.frame[:, points])

    def scaled(self, origin: np.ndarray, size: float) -> "Skin":
        """That of the mesh moved by -origin and divided by size."""
        return Skin((self.rest - origin) / size, (self.place - origin) / size, self.frame)

    def telling(self, triangles: np.ndarray, most: int = MOST) -> "Skin | None":
        """At most `most` of the poses: each time the one that bends the triangles (m, 3) most unlike those before and the
        rest; none that is like one of them. None if nothing bends."""
        a, b = triangles[:: len(triangles) // LOOKED_AT + 1, [0, 1]].T
        # from one end of a side to the other: what a turn of all together leaves as it is
        turns = np.einsum("kmji,kmjl->kmil", self.frame[:, a], self.frame[:, b]) - np.eye(3)
        unlike, chosen = np.full(len(turns), np.inf), []
        new = np.zeros_like(turns[0])
        while len(chosen) < most:
            unlike = np.minimum(unlike, np.sqrt(((turns - new) ** 2).sum(axis=(2, 3))).mean(axis=1))
            if unlike.max(initial=0) < STIFF:
                break
            chosen.append(int(unlike.argmax()))
            new = turns[chosen[-1]]
        return Skin(self.rest, self.place[chosen], self.frame[chosen]) if chosen else None
