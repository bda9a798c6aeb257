"""Files of earlier versions: what has another default now stays as it was for them."""

import bpy

from .renamed_settings import STORED

VERSION = 1  # of the settings. 1: LODs are chosen by tolerance; before, By Ratio was the default, which Blender did not save


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """load_post: settings from before there were versions choose their LODs by ratio, where they do not say otherwise."""
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and not settings.version and not settings.is_property_set("choice") and _used(settings):
            settings.choice = "BY_RATIO"
    note()


@bpy.app.handlers.persistent
def note(*_) -> None:
    """save_pre: say in all scenes of which version their settings are."""
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and _used(settings):
            if not settings.version and len(settings.groups) and not settings.is_property_set("choice"):
                settings.choice = "BY_RATIO"  # appended from such a file: populated, and not by this version
            settings.version = VERSION


def _used(settings) -> bool:
    """Whether any of the settings was ever set."""
    names = set(settings.bl_rna.properties.keys()) - {"rna_type", "name", *STORED}  # what another stores always counts as set
    return any(map(settings.is_property_set, names))
