"""Copies of objects, and objects that take another's place."""

import bpy


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
