"""Tells of viewports that are out of date without Blender's notice.

Blender redraws a viewport after an edit in its own interface, but not after a script, an operator,
a driver or an animation has set a property of ours.
"""

import bpy

from ..blender import scene_cache
from ..blender.stored_values import contents_of

# The contents of each scene's settings at the last call of `has_changed`.
_known: dict[int, str] = scene_cache.add_cache({}, by_scene=True)


def has_changed(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's settings differ from those at the last call.

    False at the first call.
    """
    now = repr(contents_of(scene.crowd_lod))  # as text, where NaN equals itself
    before = _known.get(scene.session_uid, now)
    _known[scene.session_uid] = now
    return before != now
