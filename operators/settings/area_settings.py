"""Settings of a wall or area."""

import bpy

from ..blender.character_objects import is_scenery
from ..blender.labeled_properties import BoolProperty, PointerProperty, StringProperty
from .setting_changes import settings_changed


class CrowdLodArea(bpy.types.PropertyGroup):
    """Meshes that lay a label over the label map, called `name`."""

    use: BoolProperty(
        update=settings_changed("areas"),
        name="Use",
        default=True,
        description="The label lies over the map",
    )
    object: PointerProperty(
        update=settings_changed("areas"),
        type=bpy.types.Object,
        name="Object",
        poll=lambda _, candidate: is_scenery(candidate),
        description="The label lies where this object is, seen from above",
    )
    collection: PointerProperty(
        update=settings_changed("areas"),
        type=bpy.types.Collection,
        name="Collection",
        description="The label lies where these objects are, seen from above",
    )
    label: StringProperty(
        update=settings_changed("areas"), name="Label", description="Label that lies over the map"
    )


CLASSES = (CrowdLodArea,)
