"""Mends collections after Blender's undo: their caches, which it leaves stale, and what it loses.

A collection caches the objects in it and in all collections below it. Undo and redo read only
data-blocks that changed. An unchanged collection keeps its cache, even if a collection below it got
other objects: the cache then holds freed objects. Reading it crashes Blender:
`Collection.all_objects` reads it, and so does a Collection Info node when Blender builds the
depsgraph.

Now and then undo also loses one of the many children or objects of a collection. See
docs/notes/blender_traps.md.
"""

import bpy
from bpy.types import Collection

from .callbacks import handler

CHANGES = "crowd_lod_changes"  # of a collection of the build: how often something below it changed
MOST = 2**30  # after which the count begins anew
# (a collection's children or objects, where the file has such, the custom property of a collection
# of the build that holds their names, a line each)
HELD = (
    ("children", "collections", "crowd_lod_children"),
    ("objects", "objects", "crowd_lod_objects"),
)


@handler
def renew(*_) -> None:
    """Make Blender drop the caches of all collections (undo_post, redo_post handler)."""
    item = next((item for item in bpy.data.objects if item.library is None), None)
    if item is not None:
        # setting it, also to what it is, is what makes Blender forget
        item.hide_render = item.hide_render


def note_held(*collections: Collection) -> None:
    """Note in `collections` what is in them, so that `restore` can put it back."""
    for collection in collections:
        for inside, _, key in HELD:
            collection[key] = "\n".join(getattr(collection, inside).keys())


@handler
def restore(*_) -> None:
    """Put back what undo has lost from collections of builds (undo_post, redo_post handler).

    Only what the file has still can be put back.
    """
    for collection in bpy.data.collections:
        for inside, blocks, key in HELD if collection.library is None else ():
            names = collection.get(key)
            there = getattr(collection, inside)
            for name in (
                sorted(set(names.split("\n")) - {*there.keys()}) if isinstance(names, str) else ()
            ):
                block = getattr(bpy.data, blocks).get((name, None))
                if block is not None:
                    there.link(block)


def note_change(*collections: Collection) -> None:
    """Mark `collections` as changed, so that undo reads them again.

    Each of them holds a collection that got other objects. This does the work of `renew` in a
    Blender without Crowd LOD's handlers.
    """
    for collection in collections:
        before = collection.get(CHANGES)  # anybody may have set it to anything
        collection[CHANGES] = (before if isinstance(before, int) else 0) % MOST + 1
