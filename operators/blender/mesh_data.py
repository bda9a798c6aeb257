"""Copies meshes and points between bpy and NumPy."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.mesh import Mesh, place


def count_triangles(mesh: bpy.types.Mesh) -> int:
    """Return how many triangles the mesh's faces have, none of which need to be made for it."""
    return len(mesh.loops) - 2 * len(mesh.polygons)


@dataclass(frozen=True, eq=False)
class ReadMesh(Mesh):
    """A Blender mesh as it was read: points as float32 unless placed, triangles as int32.

    corners: (m, 3) int32 loop indices.
    faces: (m,) int32, the polygon of each triangle.
    slots: (m,) int32, the material slot of each triangle.
    """

    corners: np.ndarray
    faces: np.ndarray
    slots: np.ndarray


def read_mesh(mesh: bpy.types.Mesh) -> ReadMesh:
    """Return the mesh in its own space."""
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    triangles = np.empty((count, 3), np.int32)
    corners = np.empty((count, 3), np.int32)
    faces = np.empty(count, np.int32)
    slots = np.empty(len(mesh.polygons), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    mesh.loop_triangles.foreach_get("loops", corners.ravel())
    mesh.loop_triangles.foreach_get("polygon_index", faces)
    mesh.polygons.foreach_get("material_index", slots)
    return ReadMesh(points, triangles, corners, faces, slots[faces])


def vertices_of(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the places of the mesh's vertices, (n, 3) float32."""
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points


def new_mesh(name: str, points: np.ndarray, triangles: np.ndarray) -> bpy.types.Mesh:
    """Return a new mesh of points (n, 3) and triangles (m, 3)."""
    mesh = bpy.data.meshes.new(name)
    fill_mesh(mesh, points, triangles)
    return mesh


def fill_mesh(mesh: bpy.types.Mesh, points: np.ndarray, triangles: np.ndarray) -> None:
    """Replace the geometry of `mesh` by points (n, 3) and triangles (m, 3)."""
    mesh.clear_geometry()
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points, np.float32).ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(triangles, np.int32).ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)


# Types of attributes: (name of the value, numbers in it, their type).
ATTRIBUTES = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, bool),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
    "QUATERNION": ("value", 4, np.float32),
    "INT16_2D": ("value", 2, np.int32),
    "INT32_2D": ("value", 2, np.int32),
    "FLOAT4X4": ("value", 16, np.float32),
}
KINDS = {
    (np.dtype(np.float32), 1): "FLOAT",
    (np.dtype(np.int32), 1): "INT",
    (np.dtype(np.float32), 2): "FLOAT_VECTOR",
}


def write_points(mesh: bpy.types.Mesh, columns: dict[str, np.ndarray]) -> None:
    """Replace the geometry of `mesh` by loose vertices with point attributes.

    columns: attribute name to values (m,) or (m, 3), float32 or int32, one row per vertex.
        "position" (m, 3) is the vertices' own position, in the mesh's space.

    CrowdError if the mesh is in Edit Mode, where Blender adds no vertices.
    """
    if mesh.is_editmode:
        raise CrowdError(
            f"The points {mesh.name} are in Edit Mode: leave it, and the crowd follows the frame "
            f"again."
        )
    mesh.clear_geometry()
    mesh.vertices.add(len(columns["position"]))
    for name, values in columns.items():
        if name == "position":
            attribute = mesh.attributes["position"]
            field = "vector"
        else:
            attribute = mesh.attributes.new(name, KINDS[values.dtype, values.ndim], "POINT")
            field = "vector" if values.ndim == 2 else "value"
        attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())
    mesh.update_tag()


def read_points(mesh: bpy.types.Mesh) -> dict[str, np.ndarray]:
    """Return the point attributes that `write_points` has written, in its form."""
    fields = {kind: (dtype, dimensions) for (dtype, dimensions), kind in KINDS.items()}
    columns = {}
    for attribute in mesh.attributes:
        if attribute.domain != "POINT" or attribute.data_type not in fields:
            continue
        dtype, dimensions = fields[attribute.data_type]
        values = np.empty((len(mesh.vertices), 3) if dimensions == 2 else len(mesh.vertices), dtype)
        attribute.data.foreach_get("vector" if dimensions == 2 else "value", values.ravel())
        columns[attribute.name] = values
    return columns


def world_points(evaluated: bpy.types.Object) -> np.ndarray:
    """Return the vertices of an evaluated object's mesh in world space.

    (n, 3) float64, empty if the object has no mesh, as with hair.
    """
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:
        return np.empty((0, 3))
    try:
        points = vertices_of(mesh)
    finally:
        evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def world_mesh(evaluated: bpy.types.Object) -> ReadMesh:
    """Return an evaluated object's mesh in world space, its points as float64.

    Empty if the object has no mesh, as with hair.
    """
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:
        threes = np.empty((0, 3), np.int32)
        return ReadMesh(np.empty((0, 3)), threes, threes, *np.empty((2, 0), np.int32))
    try:
        read = read_mesh(mesh)
    finally:
        evaluated.to_mesh_clear()
    return place(read, np.array(evaluated.matrix_world, np.float64))


def world_polygons(
    evaluated: bpy.types.Object, matrix: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return (points, faces) of an evaluated object's mesh, placed by `matrix`.

    points: (n, 3) float64, in world space.
    faces: the vertex indices of each face.
    matrix: (4, 4), object to world space.
    """
    mesh = evaluated.to_mesh()
    try:
        points = vertices_of(mesh)
        polygons = [np.array(polygon.vertices) for polygon in mesh.polygons]
    finally:
        evaluated.to_mesh_clear()
    return points @ matrix[:3, :3].T + matrix[:3, 3], polygons


def key_reaches(item: bpy.types.Object) -> np.ndarray:
    """How far each shape key at 1 moves the vertex that it moves most, (k,) meters.

    Of a mesh's keys but the first.
    """
    reaches = []
    for key in (
        item.data.shape_keys.key_blocks[1:] if item.type == "MESH" and item.data.shape_keys else ()
    ):
        at = np.empty((2, len(key.data), 3), np.float32)
        for each, points in zip((key, key.relative_key), at, strict=True):
            each.data.foreach_get("co", points.ravel())
        reaches.append(float(np.linalg.norm(at[0] - at[1], axis=1).max(initial=0)))
    return np.array(reaches)
