"""Upgrade of files from earlier versions: old defaults that changed are kept."""

import bpy

from .renamed_settings import STORED
from .threshold_order import note_thresholds

# By the version of the settings that brought another default: the setting, and its default before.
# Blender does not save a setting that has its default.
DEFAULTS_BEFORE = {1: ("choice", "BY_RATIO"), 2: ("frames", "1:120")}
VERSION = max(DEFAULTS_BEFORE)


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """Handle load_post: set what were defaults in the settings' own version, and note all thresholds.

    Settings that were never used, or that store a value, stay. Linked scenes stay as they are.
    """
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and _used(settings):
            _keep_defaults(settings)
            note_thresholds(settings)
    note()


@bpy.app.handlers.persistent
def note(*_) -> None:
    """Handle save_pre: store the version of the settings in scenes that use them.

    Scenes that were appended from an older file get its defaults first.
    """
    for scene in bpy.data.scenes:
        settings = scene.crowd_lod
        if scene.library is None and _used(settings):
            if len(settings.groups):  # else it may be of this version, and was never populated
                _keep_defaults(settings)
            settings.version = VERSION


def _keep_defaults(settings) -> None:
    """Set what was a default in the settings' own version and is none now."""
    for version, (name, value) in DEFAULTS_BEFORE.items():
        if settings.version < version and not settings.is_property_set(name):
            setattr(settings, name, value)


def _used(settings) -> bool:
    """Return whether any of the settings was ever set."""
    # what another stores always counts as set
    names = set(settings.bl_rna.properties.keys()) - {"rna_type", "name", *STORED}
    return any(map(settings.is_property_set, names))
