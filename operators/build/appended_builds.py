"""Live builds that stand still: from another file without their scene, in a linked scene, or where
another scene shows theirs as its Background Scene.
"""

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

    No scene's settings name them, the scene is linked, or shows them by its Background Scene.
    """
    names = _names(scene)
    if names:
        return (
            f"The build {' and '.join(names[:3])} came from another file without its scene's "
            f"settings, so it stands still: append its scene in place of it, or bake it in its own "
            f"file and take the bake."
        )
    if scene.library is not None and _is_live_in(scene):
        return (
            f"The scene {scene.name} is linked, so nothing moves its live build: append the scene, "
            f"or bake it in its own file."
        )
    sets = [each for each in _sets_of(scene) if _is_live_in(each)] if STAGE not in scene else []
    return _still_in(scene, sets[0]) if sets else ""


def note_on_sets(scene: bpy.types.Scene) -> str:
    """Return a sentence on another scene that shows `scene`, whose build is live, as its Background
    Scene; "" without.
    """
    if not _is_live_in(scene):
        return ""
    others = [each for each in bpy.data.scenes if STAGE not in each and scene in _sets_of(each)]
    return _still_in(others[0], scene) if others else ""


def _still_in(scene: bpy.types.Scene, shown: bpy.types.Scene) -> str:
    return (
        f"The scene {scene.name} shows {shown.name} as its Background Scene, where the live build "
        f"stands still: press Bake in {shown.name}."
    )


def _is_live_in(scene: bpy.types.Scene) -> bool:
    build = scene.crowd_lod.build
    return build is not None and BAKED not in build


def _sets_of(scene: bpy.types.Scene) -> list[bpy.types.Scene]:
    """Return the Background Scene of `scene`, that one's, and so on."""
    sets: list[bpy.types.Scene] = []
    shown = scene.background_set
    while shown is not None and shown not in sets:
        sets.append(shown)
        shown = shown.background_set
    return sets


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
