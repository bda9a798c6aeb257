"""What is mended of a mesh before it is decimated."""

from collections.abc import Iterator
from contextlib import contextmanager

import bmesh
import bpy
import numpy as np

from ...crowd_lod.mesh import connected_components
from ..blender import mesh_data
from .surface import has_area


def mend(mesh: bpy.types.Mesh, split_sharp: bool) -> None:
    """Remove loose vertices and edges, and sew borders that lie on each other.

    Importers split meshes along UV seams: apart, such borders would gape when decimated.
    split_sharp: whether sewn borders are to look split as before.
    """
    read = mesh_data.read_mesh(mesh)
    target = _sewn(read.points, read.triangles)
    joined = np.flatnonzero(target != np.arange(len(read.points)))
    if not len(joined):
        return drop_loose(mesh)
    with _edited(mesh) as body:
        body.verts.ensure_lookup_table()
        if split_sharp:
            for edge in body.edges:
                edge.smooth = edge.smooth and not edge.is_boundary
        bmesh.ops.weld_verts(
            body, targetmap={body.verts[int(v)]: body.verts[int(target[v])] for v in joined}
        )
        _delete_loose(body)


def drop_flat_parts(mesh: bpy.types.Mesh) -> None:
    """Remove loose parts without area, of which nothing shows.

    A LOD would spend triangles on them, and deviate there.
    """
    read = mesh_data.read_mesh(mesh)
    part = connected_components(len(read.points), read.triangles)[read.triangles[:, 0]]
    corners = read.points[read.triangles].astype(np.float64)
    has_surface = np.isin(part, part[has_area(corners)])
    if has_surface.all() or not has_surface.any():
        return
    with _edited(mesh) as body:
        body.faces.ensure_lookup_table()
        bmesh.ops.delete(
            body, geom=[body.faces[i] for i in np.unique(read.faces[~has_surface])], context="FACES"
        )
        _delete_loose(body)


def drop_loose(mesh: bpy.types.Mesh) -> None:
    """Remove the mesh's vertices and edges that have no face."""
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    if len(np.unique(corners)) == len(mesh.vertices):
        return
    with _edited(mesh) as body:
        _delete_loose(body)


def _delete_loose(body: bmesh.types.BMesh) -> None:
    bmesh.ops.delete(body, geom=[e for e in body.edges if not e.link_faces], context="EDGES")
    bmesh.ops.delete(body, geom=[v for v in body.verts if not v.link_faces], context="VERTS")


@contextmanager
def _edited(mesh: bpy.types.Mesh) -> Iterator[bmesh.types.BMesh]:
    """Yield a BMesh of `mesh`, and write it back afterwards."""
    body = bmesh.new()
    try:
        body.from_mesh(mesh)
        yield body
        body.to_mesh(mesh)
    finally:
        body.free()


def _sewn(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the point that each of the points is to be joined to, (n,).

    Two border edges are joined if they lie at the same place, with no third one there, and run
    against each other. Edges of triangles that lie on each other stay apart: these are the two
    sides of a card.
    """
    count = len(points)
    half = (
        np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
        .reshape(-1, 2)
        .astype(np.int64)
    )
    low = half.min(axis=1)
    high = half.max(axis=1)
    _, first, times = np.unique(low * count + high, return_index=True, return_counts=True)
    border = first[times == 1]
    if not len(border):
        return np.arange(count)
    a, b, c = (points[triangles[:, i]].astype(np.float64) for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-30)
    _, place = np.unique(points[half[border]].reshape(-1, 3), axis=0, return_inverse=True)
    place = place.reshape(-1, 2).astype(np.int64)
    key = place.min(axis=1) * count + place.max(axis=1)
    _, index, times = np.unique(key, return_inverse=True, return_counts=True)
    order = np.argsort(index, kind="stable")
    order = order[times[index[order]] == 2].reshape(-1, 2)
    against = place[order[:, 0], 0] == place[order[:, 1], 1]
    facing = (normal[border[order[:, 0]] // 3] * normal[border[order[:, 1]] // 3]).sum(axis=1)
    one, other = half[border[order[against & (facing > -0.99)]]].transpose(1, 0, 2)
    return connected_components(count, np.stack([one, other[:, ::-1]], axis=2).reshape(-1, 2))
