"""The objects of a character group: those with a shape, and props, which some agents have."""

from collections.abc import Iterable, Sequence

import bpy

from ...crowd_lod.errors import CrowdError

# custom property of an object: the chance that an agent has it, and all that is parented to it
PROP = "prop"
JOINT = " + "  # in a part's name, between the group and what its agents wear


def group_of(name: str) -> str:
    """Return the name of the group whose agents wear the part called `name`; of a group its own."""
    return name.partition(JOINT)[0]


def prop_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the outermost prop that the object is, or is parented to; None if it is of no prop."""
    prop = None
    while item is not None:
        prop = item if PROP in item else prop
        item = item.parent
    return prop


# kinds of objects whose shape may be a mesh
GEOMETRY = {"MESH", "CURVE", "SURFACE", "FONT", "CURVES"}

# kinds of objects that renders show, and that have no faces
WITHOUT_FACES = {"POINTCLOUD": "point cloud", "VOLUME": "volume", "GREASEPENCIL": "Grease Pencil"}

# kinds of objects that stand beside characters
STAGE = {"LIGHT", "CAMERA", "EMPTY", "SPEAKER", "LIGHT_PROBE", "LATTICE"}


# types of objects with a surface, that may be walls
SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}


def is_stage(objects: Sequence[bpy.types.Object]) -> bool:
    """Return whether `objects`, at least one, are lamps, cameras and the like alone: no character.

    Instances of collections and missing objects may be characters.
    """
    return bool(objects) and not any(
        item.type not in STAGE or item.is_missing or item.instance_collection is not None
        for item in objects
    )


def parts(
    owner: bpy.types.Collection | bpy.types.Object, objects: list[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return the objects of the character group `owner` that have a shape.

    Left out: objects hidden in renders, unless all are hidden; and objects that are custom shapes
    of bones.
    CrowdError if a data-block is missing, or an object is a metaball or instances a collection.
    """
    for block in (owner, *objects, *(item.data for item in objects if item.data is not None)):
        if block.is_missing:
            path = block.library.filepath if block.library else "its library"
            raise CrowdError(
                f"{block.name}, of the character group {owner.name}, is missing: restore {path}, "
                f"or link it again."
            )
    for item in objects:
        if item.type == "META":
            raise CrowdError(
                f"{item.name}, of the character group {owner.name}, is a metaball: turn it into a "
                f"mesh (Object > Convert)."
            )
        if item.instance_type == "COLLECTION" and item.instance_collection is not None:
            raise CrowdError(
                f"{item.name}, of the character group {owner.name}, instances the collection "
                f"{item.instance_collection.name}: put that "
                "collection in its place, or make the instance real (Object > Apply)."
            )
    shapes = bone_shapes(objects)
    surfaces = [item for item in objects if item.type in GEOMETRY and item not in shapes]
    inside = [] if isinstance(owner, bpy.types.Object) else owner.children_recursive
    hidden = {
        item for collection in inside if collection.hide_render for item in collection.all_objects
    }
    return [item for item in surfaces if not item.hide_render and item not in hidden] or surfaces


def bone_shapes(objects: Iterable[bpy.types.Object]) -> set[bpy.types.Object]:
    """Return the objects that the bones of rigs among `objects` are drawn as."""
    rigs = [item for item in objects if item.type == "ARMATURE"]
    return {bone.custom_shape for rig in rigs for bone in rig.pose.bones} - {None}


def may_have_faces(item: bpy.types.Object) -> bool:
    """Return whether the object may have faces, also those that a modifier makes."""
    return item.type != "MESH" or len(item.data.polygons) > 0 or len(item.modifiers) > 0


def selected_scenery(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects that may be walls and are of no character."""
    characters = context.scene.crowd_lod.characters
    members = set() if characters is None else set(characters.all_objects)
    return [item for item in context.selected_objects if is_scenery(item) and item not in members]


def is_scenery(item: bpy.types.Object) -> bool:
    """Return whether an object may be a wall, and is none of Crowd LOD's own."""
    return (item.type in SURFACES or item.is_instancer) and not any(
        key.startswith("crowd_lod") for key in item.keys()
    )
