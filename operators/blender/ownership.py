"""Ownership marks on data-blocks and handlers that belong to Crowd LOD.

Crowd LOD may remove what it made.
"""

from collections.abc import Callable, Sequence

import bpy

from . import removal

OWNED = "crowd_lod"  # custom property on what Crowd LOD made, and may remove
PACKAGE = __package__.rpartition(".")[0]  # that all our handlers are from


def is_ours(handler: Callable) -> bool:
    """Return whether `handler`, from one of bpy.app.handlers, belongs to Crowd LOD."""
    module = getattr(handler, "__module__", None)  # of a callable object, None or anything
    return isinstance(module, str) and module.startswith(f"{PACKAGE}.")


def remove_owned(top: bpy.types.Collection, heirs: Sequence[bpy.types.Collection] = ()) -> None:
    """Remove the collection `top` and everything in it that Crowd LOD made.

    The user's own collections and objects in it move up to the scene.

    heirs: one for each child of `top`, in order; whatever refers to a child, such as a build, then
        refers to its heir.
    """
    inside = {top}
    left = [top]
    while left:
        ours = {child for child in left.pop().children if child.get(OWNED)} - inside
        inside |= ours
        left += ours
    others = [*bpy.data.collections, *(scene.collection for scene in bpy.data.scenes)]
    kept = {child for other in others if other not in inside for child in other.children}
    scenes = [scene for scene in bpy.data.scenes if top in scene.collection.children_recursive]
    for child in {child for home in inside for child in home.children} - kept - inside:
        for scene in scenes:
            scene.collection.children.link(child)
    for item in list(top.all_objects):
        if not item.get(OWNED) and set(item.users_collection).issubset(inside):
            for scene in item.users_scene:
                scene.collection.objects.link(item)
    objects = [o for o in top.all_objects if o.get(OWNED)]
    data = {o.data for o in objects if o.data is not None and o.data.get(OWNED)}
    users = bpy.data.user_map(subset=data)
    # the user may have put one into objects of their own
    data = [block for block in data if users[block].issubset(objects)]
    doomed = [*objects, *data, *inside]
    for child, heir in zip(list(top.children), heirs, strict=False):
        child.user_remap(heir)
    removal.remove(doomed)
    # each kind may hold data of the next
    for kind in (bpy.data.actions, bpy.data.materials, bpy.data.node_groups, bpy.data.images):
        while unused := [block for block in kind if block.get(OWNED) and not block.users]:
            removal.remove(unused)
