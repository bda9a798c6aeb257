"""The inside of a closed mesh, as a region."""

import hashlib

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...crowd_lod.errors import CrowdError

ALONG = Vector((0.1737, 0.0931, 0.9804))  # direction of rays: along no edge or face of a model
ONWARD = 1e-6  # part of the mesh's size by which a ray goes on behind a surface that it met


def is_closed(mesh: bpy.types.Mesh) -> bool:
    """Return whether each edge of the mesh is between two faces, so that it has an inside."""
    edges = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("edge_index", edges)
    return len(edges) > 0 and bool((np.bincount(edges, minlength=len(mesh.edges)) == 2).all())


def in_volume(item: bpy.types.Object, points: np.ndarray, title: str) -> np.ndarray:
    """Return which of the points (n, 3) lie inside the closed mesh of the object `item`, (n,) bool.

    The object is evaluated.

    A ray from a point inside meets the surface an odd number of times.
    CrowdError if the mesh has no inside; `title` is what the error calls it.
    """
    matrix = np.array(item.matrix_world, np.float64)
    if not is_closed(item.data) or not np.linalg.cond(matrix) < 1e9:
        raise CrowdError(
            f"{title} is no closed mesh: fill its holes, give it a scale above 0, or set Agents By "
            f"to Region."
        )
    corners = _corners(item.data)
    low = corners.min(axis=0)[:, None]
    high = corners.max(axis=0)[:, None]
    tree = BVHTree.FromPolygons(
        corners.tolist(), [tuple(face.vertices) for face in item.data.polygons]
    )
    with np.errstate(invalid="ignore"):  # a point at NaN is in no mesh
        local = np.linalg.solve(matrix[:3, :3], points.T - matrix[:3, 3:])
        inside = ((local >= low) & (local <= high)).all(axis=0)
    onward = ALONG * (ONWARD * float((high - low).max()))
    for index in np.flatnonzero(inside):
        start = Vector(local[:, index])
        met = 0
        while (hit := tree.ray_cast(start, ALONG)[0]) is not None:
            start = hit + onward
            met = met + 1
        inside[index] = met % 2 == 1
    return inside


def shape_of(mesh: bpy.types.Mesh) -> str:
    """Return what changes with the places of the mesh's vertices."""
    return hashlib.sha256(_corners(mesh).tobytes()).hexdigest()[:16]


def _corners(mesh: bpy.types.Mesh) -> np.ndarray:
    corners = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", corners)
    return corners.reshape(-1, 3)
