"""Live builds from another file that stand still: without their scene, or in a linked one."""

import bpy

from ..blender.sidebar_answers import hold
from .nodes import instances, trees
from .render_setup import BAKED, LOD_SIZES
from .shelves import LEVEL

# Custom property of scenes that a run of ours draws: it moves their build itself.
STAGE = "crowd_lod_stage"


@hold()
def standing_still(scene: bpy.types.Scene) -> str:
    """Return a sentence on live builds in the scene that nothing moves; "" without.

    No scene's settings name them, or the scene is linked.
    """
    names = _names(scene)
    if names:
        return (
            f"The build {' and '.join(names[:3])} came from another file without its scene's "
            f"settings, so it stands still: append its scene in place of it, or bake it in its own "
            f"file and take the bake."
        )
    build = scene.crowd_lod.build
    if scene.library is not None and build is not None and BAKED not in build:
        return (
            f"The scene {scene.name} is linked, so nothing moves its live build: append the scene, "
            f"or bake it in its own file."
        )
    return ""


def _names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of the collections, or else of the points, that nothing moves."""
    if STAGE in scene:
        return []
    builds = {owner.crowd_lod.build for owner in bpy.data.scenes}
    names = []
    for item in _all_objects(scene):
        if LEVEL in item and any(map(_is_live, item.modifiers)):
            homes = item.users_collection
            if builds.isdisjoint(homes):
                names.append(next((home.name for home in homes if LOD_SIZES in home), item.name))
    return sorted(set(names))


def _all_objects(scene: bpy.types.Scene) -> set[bpy.types.Object]:
    """Return the scene's objects, and those of collections that it instances, as *Link* does."""
    reached = {*scene.objects}
    newest = reached
    while (
        newest := {
            item
            for empty in newest
            if empty.instance_type == "COLLECTION" and empty.instance_collection
            for item in empty.instance_collection.all_objects
        }
        - reached
    ):
        reached |= newest
    return reached


def _is_live(modifier: bpy.types.Modifier) -> bool:
    tree = modifier.node_group if modifier.type == "NODES" else None
    return tree is not None and tree.get(trees.KIND) == instances.NAME
