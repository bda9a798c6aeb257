"""Objects: their copies, those that take the place of others, and the boxes about them."""

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError

FLAT = 1e-6  # a box thinner than this part of its largest size is flat


def box_of(item: bpy.types.Object) -> np.ndarray:
    """Return the lowest and the highest corner of the object's box in its space, (2, 3) float64."""
    if item.type == "EMPTY":
        return np.array([[-1.0], [1.0]]) * np.full((2, 3), item.empty_display_size)
    corners = np.array(item.bound_box, np.float64)
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def in_box(item: bpy.types.Object, points: np.ndarray, title: str) -> np.ndarray:
    """Return which of the points (n, 3) lie in the box about an evaluated object, (n,) bool.

    A flat box, such as a plane's, reaches up and down without end.
    CrowdError if the box has no area.

    title: what the error calls the object.
    """
    low, high = box_of(item)
    size = high - low
    matrix = np.array(item.matrix_world, np.float64)
    flat = size <= FLAT * size.max()
    if flat.sum() > 1 or not np.linalg.cond(matrix) < 1e9:
        raise CrowdError(
            f"{title} has no area: give it vertices that span one, or a scale above 0."
        )
    with np.errstate(invalid="ignore"):  # a point at NaN is in no box
        own = np.linalg.solve(matrix[:3, :3], points.T - matrix[:3, 3:])
        return (flat[:, None] | ((own >= low[:, None]) & (own <= high[:, None]))).all(axis=0)


def copy_unlinked(item: bpy.types.Object) -> bpy.types.Object:
    """Return a local copy of the object that shares its data and is in no collection.

    Blender puts a copy of a rigid body into the simulation, through a collection: it is taken out.
    """
    copy = item.copy()
    if copy.override_library:
        copy.make_local()
    for collection in copy.users_collection:
        collection.objects.unlink(copy)
    return copy


# what an object that takes another's place keeps of it
SHOWN = (
    "hide_render",
    "hide_viewport",
    "visible_camera",
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
    "visible_shadow",
    "is_holdout",
    "is_shadow_catcher",
    "pass_index",
    "color",
)


def mesh_like(item: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a new object of `mesh` that looks like `item`.

    `item` is of another kind, such as a text or a curve, and cannot hold a mesh. Copied are the
    properties of SHOWN, custom properties and materials linked to the object.
    """
    copy = bpy.data.objects.new(item.name, mesh)
    for name in SHOWN:
        setattr(copy, name, getattr(item, name))
    for key, value in item.items():
        copy[key] = value
    for slot, source in zip(copy.material_slots, item.material_slots, strict=False):
        if source.link == "OBJECT":
            slot.link = "OBJECT"
            slot.material = source.material
    return copy
