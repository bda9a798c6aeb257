"""Shaded comparison of LODs: read normals, colors and images, compare pictures."""

from collections.abc import Sequence

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.mesh import join, place
from ...crowd_lod.validation.shaded_pictures import (
    HALVINGS,
    LARGEST,
    WITHIN,
    ShadedMesh,
    from_afar,
    likeness,
    lit,
    pictures,
)
from ...crowd_lod.validation.silhouette import project
from ..blender import mesh_data
from ..blender.colors import Looks, color_attribute_of

AROUND = np.radians((35, 155, 275))  # where the body is looked at from
ABOVE = np.radians((0, 40))  # for where its colors differ
LEAST = 1e-3  # a difference of less counts as this
MOST_TALL = 300  # pixels of a body's size


def body_of(
    mesh: bpy.types.Mesh, materials: Sequence, matrix: np.ndarray, appearance: Looks
) -> ShadedMesh:
    """Return the `mesh`, to be drawn, with `materials`, transformed by `matrix`.

    matrix: (4, 4), from the mesh's space to that of the result.
    appearance: collects the images of the materials.
    """
    read = mesh_data.read_mesh(mesh)
    normals = np.empty((len(mesh.loops), 3), np.float32)
    mesh.corner_normals.foreach_get("vector", normals.ravel())
    uvs = np.zeros((len(mesh.loops), 2), np.float32)
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is not None:
        layer.uv.foreach_get("vector", uvs.ravel())
    table = np.array([appearance.of(material) for material in (*materials, None)])
    slots = np.minimum(read.slots, max(len(materials) - 1, 0))
    image = table[slots, 3].astype(np.intp)
    colors = np.repeat(table[slots, None, :3], 3, axis=1)
    for slot, material in enumerate(materials):
        attribute = _color_attribute(mesh, color_attribute_of(material))
        if attribute is not None:
            of_slot = np.flatnonzero((slots == slot) & (image < 0))
            colors[of_slot] = _at_corners(mesh, attribute, read)[of_slot]
    normals = normals[read.corners].astype(np.float64) @ np.linalg.pinv(matrix[:3, :3])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True).clip(1e-12)
    return ShadedMesh(
        place(read, matrix).points,
        read.triangles,
        normals,
        uvs[read.corners].astype(np.float64),
        colors,
        image,
    )


def is_painted(objects: Sequence[bpy.types.Object]) -> bool:
    """Return whether images or color attributes color some of the objects."""
    materials = {slot.material for item in objects for slot in item.material_slots}
    appearance = Looks()
    return any(
        appearance.of(material)[3] >= 0 or color_attribute_of(material) is not None
        for material in materials
    )


def _color_attribute(mesh: bpy.types.Mesh, name: str | None) -> bpy.types.Attribute | None:
    """Return the mesh's color attribute of that name, its own for "", or None."""
    if name == "":
        name = mesh.color_attributes.default_color_name
    return mesh.color_attributes.get(name) if name else None


def _at_corners(
    mesh: bpy.types.Mesh, attribute: bpy.types.Attribute, read: mesh_data.ReadMesh
) -> np.ndarray:
    """Return the linear colors (m, 3, 3) of the triangles' corners."""
    values = np.empty((len(attribute.data), 4), np.float32)
    attribute.data.foreach_get("color", values.ravel())
    return values[read.corners if attribute.domain == "CORNER" else read.triangles, :3]


def bodies_of(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph, appearance: Looks
) -> ShadedMesh | None:
    """Return one ShadedMesh of all `objects` as `depsgraph` has evaluated them, or None.

    It is in world space. None if no object has a face.
    """
    bodies = []
    for item in objects:
        evaluated = item.evaluated_get(depsgraph)
        try:
            mesh = evaluated.to_mesh()
        except RuntimeError:  # hair has none
            continue
        try:
            if mesh is not None and mesh.polygons:
                materials = [slot.material for slot in evaluated.material_slots]
                bodies.append(
                    body_of(
                        mesh, materials, np.array(evaluated.matrix_world, np.float64), appearance
                    )
                )
        finally:
            evaluated.to_mesh_clear()
    return join(bodies) if bodies else None


def side(azimuth: float, above: float = 0.0) -> np.ndarray:
    """Return (3, 3) axes of a view: right, up, towards the eye.

    azimuth, above: radians, the direction from the body to the eye, and its height.
    """
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array(
        [np.cos(above) * np.cos(azimuth), np.cos(above) * np.sin(azimuth), np.sin(above)]
    )
    return np.stack([right, np.cross(towards, right), towards])


def within(first: ShadedMesh, second: ShadedMesh, images: np.ndarray, diagonal: float) -> float:
    """Return the size of a pixel, in meters, from which on two bodies look alike.

    Pictures look alike if no block of one from any side differs by more than WITHIN. From this size
    on they do at every coarser one; between two sizes that were drawn it is told by the logarithms.
    The result is 0 if they look alike at every size up to a diagonal of LARGEST pixels, and inf if
    they differ even in the smallest picture.

    images: (i, size, size, 4) uint8, of the bodies' materials.
    diagonal: meters, of the character's bounding box.
    """
    scale = LARGEST / diagonal
    differences = []
    for axes in (side(azimuth, above) for azimuth in AROUND for above in ABOVE):
        flat = [body.points @ axes.T * (scale, scale, -scale) for body in (first, second)]
        differences.append(from_afar(*lit((first, second), images, flat, axes)))
    worst = np.max(differences, axis=0)
    wrong = np.flatnonzero(worst > WITHIN)
    if not len(wrong):
        return 0.0
    last = int(wrong[-1])
    if last == HALVINGS:
        return np.inf
    before, after = np.log(worst[last : last + 2].clip(LEAST) / WITHIN)
    return float(2 ** (last + before / (before - after)) / scale)


def alike(
    first: ShadedMesh,
    second: ShadedMesh,
    images: np.ndarray,
    center: np.ndarray,
    distance: float,
    camera: Camera,
) -> tuple[float, float]:
    """Return (mean difference, structural similarity) of two bodies' pictures.

    Both are means over all sides. The difference is of sRGB values from 0 to 1. Each picture is
    what `camera` shows when it looks at `center` from `distance`, reduced to at most MOST_TALL
    pixels.

    images: (i, size, size, 4) uint8, of the bodies' materials.
    center: (3,) meters.
    distance: meters.
    """
    measures = []
    for azimuth in AROUND:
        axes = side(azimuth)
        flat = [project(body.points, center, axes[2], distance, camera) for body in (first, second)]
        smaller = min(1.0, MOST_TALL / max(np.ptp(flat[0][:, :2], axis=0).max(), 1e-9))
        measures.append(
            likeness(
                *pictures(
                    (first, second), images, [at * (smaller, smaller, 1) for at in flat], axes
                )
            )
        )
    difference, similarity = np.mean(measures, axis=0)
    return float(difference), float(similarity)
