"""Opaque scenery that may hide agents: its triangles, and the edges where they meet."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..mesh import connected_components


@dataclass(frozen=True)
class Topology:
    """How the triangles of a mesh meet, wherever it stands.

    triangles: (m, 3) intp vertices. Vertices at the same place count as one.
    edges: (e, 2) intp vertices.
    sides: (e, 2) intp, the triangles that meet at an edge and go on from each other; the second is
        -1 where none does. An edge of three triangles, or of two that face opposite ways, is listed
        once for each.
    component: (m,) intp, rising: the connected component of each triangle.
    components: their number.
    """

    triangles: np.ndarray
    edges: np.ndarray
    sides: np.ndarray
    component: np.ndarray
    components: int


@dataclass(frozen=True, eq=False)  # compared by identity
class Occluders:
    """Scenery at one time.

    points: (n, 3) float64, world meters.
    topology: how its triangles meet.
    """

    points: np.ndarray
    topology: Topology

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """(least, greatest) corner of each connected component, (components, 3) meters each."""
        begins = np.searchsorted(self.topology.component, np.arange(self.topology.components))
        corners = self.points[self.topology.triangles]
        if not len(corners):
            return np.empty((0, 3)), np.empty((0, 3))
        return (
            np.minimum.reduceat(corners.min(axis=1), begins),
            np.maximum.reduceat(corners.max(axis=1), begins),
        )


def topology_of(points: np.ndarray, triangles: np.ndarray) -> Topology:
    """Return the Topology of a mesh.

    points: (n, 3).
    triangles: (m, 3) vertices.
    """
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    welded = first[same.ravel()][triangles].astype(np.intp)
    is_flat = (welded == np.roll(welded, 1, axis=1)).any(axis=1)
    welded = welded[~is_flat]
    labels = connected_components(len(points), welded)[welded[:, 0]]
    order = np.argsort(labels, kind="stable")
    numbers, component = np.unique(labels[order], return_inverse=True)
    edges, sides = _edges(welded[order])
    return Topology(welded[order], edges, sides, component.astype(np.intp), len(numbers))


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the `edges` and the `sides` of a Topology."""
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    of_triangle = np.tile(np.arange(len(triangles)), 3)
    is_forward = directed[:, 0] < directed[:, 1]
    ends = np.sort(directed, axis=1)
    order = np.lexsort((is_forward, ends[:, 1], ends[:, 0]))
    ends = ends[order]
    of_triangle = of_triangle[order]
    is_forward = is_forward[order]
    begins = np.flatnonzero(np.r_[True, (ends[1:] != ends[:-1]).any(axis=1)][: len(ends)])
    count = np.diff(np.r_[begins, len(ends)])
    pairs = begins[count == 2]
    pairs = pairs[is_forward[pairs] != is_forward[pairs + 1]]
    is_paired = np.zeros(len(ends), bool)
    is_paired[pairs] = True
    is_paired[pairs + 1] = True
    alone = np.flatnonzero(~is_paired)
    sides = np.concatenate(
        [
            np.stack([of_triangle[pairs], of_triangle[pairs + 1]], axis=1),
            np.stack([of_triangle[alone], np.full(len(alone), -1)], axis=1),
        ]
    )
    return np.concatenate([ends[pairs], ends[alone]]), sides


def join_occluders(parts: Sequence[Occluders]) -> Occluders:
    """Return all `parts` as one; they do not meet."""
    vertices = np.cumsum([0, *(len(part.points) for part in parts)])
    triangles = np.cumsum([0, *(len(part.topology.triangles) for part in parts)])
    components = np.cumsum([0, *(part.topology.components for part in parts)])
    rows = list(
        zip(parts, vertices.tolist(), triangles.tolist(), components.tolist(), strict=False)
    )
    return Occluders(
        np.concatenate([np.empty((0, 3)), *(part.points for part in parts)]),
        Topology(
            _stacked([part.topology.triangles + v for part, v, _, _ in rows], 3),
            _stacked([part.topology.edges + v for part, v, _, _ in rows], 2),
            _stacked(
                [
                    np.where(part.topology.sides < 0, -1, part.topology.sides + t)
                    for part, _, t, _ in rows
                ],
                2,
            ),
            np.concatenate(
                [np.empty(0, np.intp), *(p.topology.component + c for p, _, _, c in rows)]
            ),
            int(components[-1]),
        ),
    )


def _stacked(arrays: list[np.ndarray], width: int) -> np.ndarray:
    """Return the rows of all `arrays` (k, width), intp."""
    return np.concatenate([np.empty((0, width), np.intp), *arrays])
