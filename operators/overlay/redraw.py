"""Redraws viewports that are out of date without Blender's notice.

Blender redraws a viewport after an edit in its own interface, but not after a script, an operator,
a driver or an animation has set a property of ours.
"""

from typing import Any

import bpy

from ..blender import scene_cache

# The contents of each scene's settings at the last call of `has_changed`.
_known: dict[int, str] = scene_cache.add_cache({}, by_scene=True)


def viewports() -> None:
    """Have all 3D viewports drawn again, with their sidebars."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def has_changed(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's settings differ from those at the last call.

    False at the first call.
    """
    now = repr(_contents(scene.crowd_lod))  # as text, where NaN equals itself
    before = _known.get(scene.session_uid, now)
    _known[scene.session_uid] = now
    return before != now


def _contents(settings: bpy.types.PropertyGroup) -> tuple:
    """Return the values of all properties, those of collections too, and the lines of texts."""
    kinds = (
        (name, kind) for name, kind in settings.bl_rna.properties.items() if name != "rna_type"
    )
    return tuple(_value(kind, getattr(settings, name)) for name, kind in kinds)


def _value(kind: bpy.types.Property, value: Any) -> Any:
    if kind.type == "COLLECTION":
        return tuple(map(_contents, value))
    if kind.type == "POINTER":
        return (
            value.as_string() if isinstance(value, bpy.types.Text) else value and value.session_uid
        )
    return tuple(value) if getattr(kind, "is_array", False) else value
