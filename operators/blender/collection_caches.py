"""Renews the caches of collections, which Blender's undo leaves stale.

A collection caches the objects in it and in all collections below it. Undo and redo read only
data-blocks that changed. An unchanged collection keeps its cache, even if a collection below it got
other objects: the cache then holds freed objects. Reading it crashes Blender:
`Collection.all_objects` reads it, and so does a Collection Info node when Blender builds the
depsgraph. See docs/notes/undo.md.
"""

import bpy

CHANGES = "crowd_lod_changes"  # of a collection of the build: how often something below it changed
MOST = 2**30  # it begins anew there


@bpy.app.handlers.persistent
def renew(*_) -> None:
    """Make Blender drop the caches of all collections (undo_post, redo_post handler)."""
    item = next((item for item in bpy.data.objects if item.library is None), None)
    if item is not None:
        # setting it, also to what it is, is what makes Blender forget
        item.hide_render = item.hide_render


def note_change(*collections: bpy.types.Collection) -> None:
    """Mark `collections` as changed, so that undo reads them again.

    Each of them holds a collection that got other objects. This does the work of `renew` in a
    Blender without Crowd LOD's handlers.
    """
    for collection in collections:
        before = collection.get(CHANGES)  # anybody may have set it to anything
        collection[CHANGES] = (before if isinstance(before, int) else 0) % MOST + 1
