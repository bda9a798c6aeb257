"""Upgrade of files from earlier versions: old defaults that changed are kept."""

import bpy

from .renamed_settings import STORED
from .threshold_order import note_thresholds

# of the settings. 1: LODs are chosen by tolerance; before, By Ratio was the default, which Blender
# did not save
VERSION = 1


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """Handle load_post: set By Ratio in settings without a version, and note all thresholds.

    Settings that were never used, or that store a choice, stay. By Ratio was the default then.
    Linked scenes stay as they are.
    """
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and not settings.version and not settings.is_property_set("choice") and _used(settings):
            settings.choice = "BY_RATIO"
        if scene.library is None and _used(settings):
            note_thresholds(settings)
    note()


@bpy.app.handlers.persistent
def note(*_) -> None:
    """Handle save_pre: store the version of the settings in scenes that use them.

    Scenes that were appended from an older file get By Ratio first.
    """
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and _used(settings):
            if not settings.version and len(settings.groups) and not settings.is_property_set("choice"):
                # appended from such a file: populated, and not by this version
                settings.choice = "BY_RATIO"
            settings.version = VERSION


def _used(settings) -> bool:
    """Return whether any of the settings was ever set."""
    # what another stores always counts as set
    names = set(settings.bl_rna.properties.keys()) - {"rna_type", "name", *STORED}
    return any(map(settings.is_property_set, names))
