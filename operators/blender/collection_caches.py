"""What Blender's undo leaves stale: the caches of collections.

A collection caches the objects in it and in all collections below it. Undo and redo read only data-blocks that
changed. An unchanged collection keeps its cache, even where a collection below it got other objects: the cache then
holds objects that are freed. Whatever reads it crashes Blender: `Collection.all_objects`, or a Collection Info node
when Blender builds the dependency graph. See docs/notes/undo.md.
"""

import bpy

CHANGES = "crowd_lod_changes"  # of a collection of the build: how often something below it changed


@bpy.app.handlers.persistent
def renew(*_) -> None:
    """undo_post, redo_post: let Blender forget the caches of all collections, before it reads one of them."""
    item = next((item for item in bpy.data.objects if item.library is None), None)
    if item is not None:
        item.hide_render = item.hide_render  # setting it, also to what it is, is what makes Blender forget


def note_change(*collections: bpy.types.Collection) -> None:
    """Change `collections`, each of which holds a collection that got other objects: undo then reads them, too.

    It is `renew` for files that are opened where Crowd LOD, and so its handlers, are not.
    """
    for collection in collections:
        collection[CHANGES] = collection.get(CHANGES, 0) + 1
