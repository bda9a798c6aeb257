"""A surface as arrays: points, the triangles between them, and its connected components."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np


@dataclass(frozen=True, eq=False)  # compared by identity
class Mesh:
    """A surface of triangles.

    Kinds of Mesh say more of its points or its triangles, by further arrays with a row for each.

    points: (n, 3).
    triangles: (m, 3) indices of points.
    """

    points: np.ndarray
    triangles: np.ndarray


EMPTY = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))  # what parts are joined to
AnyMesh = TypeVar("AnyMesh", bound=Mesh)


def place(mesh: AnyMesh, matrix: np.ndarray) -> AnyMesh:
    """Return the mesh placed by `matrix` (4, 4)."""
    return replace(mesh, points=mesh.points @ matrix[:3, :3].T + matrix[:3, 3])


def join(meshes: Sequence[AnyMesh]) -> AnyMesh:
    """Return one mesh of several of the same kind, one after another; they do not meet.

    Of what is no array, that of the first counts.
    """
    shift = 0
    triangles = []
    for mesh in meshes:
        triangles.append(mesh.triangles + mesh.triangles.dtype.type(shift))
        shift += len(mesh.points)
    columns = {
        field.name: np.concatenate([getattr(mesh, field.name) for mesh in meshes])
        for field in fields(meshes[0])
        if isinstance(getattr(meshes[0], field.name), np.ndarray)
    }
    return replace(meshes[0], **{**columns, "triangles": np.concatenate(triangles)})


def connected_components(count: int, joined: np.ndarray) -> np.ndarray:
    """Return (count,) intp: the least vertex of each vertex's component, what edges or faces join.

    joined: (m, k) vertices, for example edges (m, 2) or triangles (m, 3). Each row joins its
        vertices.
    """
    label = np.arange(count)
    before = None
    while before is None or (label != before).any():
        before = label.copy()
        least = label[joined].min(axis=1)
        for column in joined.T:
            np.minimum.at(label, label[column], least)
            np.minimum.at(label, column, least)
        label = label[label]
    return label
