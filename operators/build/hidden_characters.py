"""The characters themselves, which a build hides from renders: they would stand in the picture, uncounted."""

import bpy

HIDDEN = (
    "crowd_lod_hidden"  # custom property of the build's collection: the characters' collection, if the build hides it from renders
)


def hide_characters(scene: bpy.types.Scene) -> None:
    """Hide the characters themselves from renders, which show the build, if nothing stands against it."""
    top, characters = scene.crowd_lod.build, scene.crowd_lod.characters
    unhide_characters(top)
    if hides_characters(scene):
        characters.hide_render, top[HIDDEN] = True, characters


def hides_characters(scene: bpy.types.Scene) -> bool:
    """Whether the characters' collection of `scene`, which renders show, may and should be hidden from them."""
    return shows_characters(scene) and not scene.crowd_lod.keep_characters and not _shown_for(scene)


def shows_characters(scene: bpy.types.Scene) -> bool:
    """Whether renders of `scene` show the characters themselves, by their own collection."""

    def shows(place: bpy.types.LayerCollection, inside: bool) -> bool:
        inside = inside or place.collection == scene.crowd_lod.characters
        below = any(shows(child, inside) for child in place.children)
        return not place.collection.hide_render and (below or (inside and not place.exclude))

    return any(shows(layer.layer_collection, False) for layer in scene.view_layers if layer.use)


def unhide_characters(top: bpy.types.Collection) -> None:
    """Show again in renders what the build `top` hides, unless another scene's build of the same characters is there: it is
    that one's then."""
    hidden = top.pop(HIDDEN, None)
    if not isinstance(hidden, bpy.types.Collection):  # a script may have put anything there
        return
    others = [scene.crowd_lod.build for scene in bpy.data.scenes if scene.crowd_lod.characters == hidden]
    others = [other for other in others if other not in (None, top)]
    if others:
        others[0][HIDDEN] = hidden
    else:
        hidden.hide_render = False


def _shown_for(scene: bpy.types.Scene) -> str:
    """Why the characters' collection of `scene` is not to be hidden as a whole; "" if it may."""
    characters = scene.crowd_lod.characters
    if characters.library is not None:
        return f"the collection is linked from {characters.library.filepath}; hide it there, or exclude it from the view layers"
    users = bpy.data.user_map(subset={characters})[characters]
    names = [user.name for user in users if isinstance(user, bpy.types.Object | bpy.types.NodeTree)]
    others = (other for other in bpy.data.scenes if other.crowd_lod.characters != characters)
    names += [other.name for other in others if characters in other.collection.children_recursive]
    return f"{' and '.join(sorted(names))} would no longer show them" if names else ""


def told_of_characters(scene: bpy.types.Scene) -> str:
    """A sentence on the characters themselves in renders of the built scene; "" if Build left them as they were."""
    characters = scene.crowd_lod.characters
    if HIDDEN in scene.crowd_lod.build:
        lamps = [item.name for item in characters.all_objects if item.type == "LIGHT"]
        return f"The characters in {characters.name} are hidden from renders{', with ' + ' and '.join(lamps) if lamps else ''}."
    if scene.crowd_lod.keep_characters or not shows_characters(scene):
        return ""
    return f"The characters in {characters.name} stay in renders: {_shown_for(scene)}."
