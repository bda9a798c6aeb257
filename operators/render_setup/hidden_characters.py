"""Hide the characters themselves from renders of a build.

There they would stand in the picture, uncounted.
"""

import bpy

from ..characters.glow import notes_on_glow
from ..settings.messages import in_words

HIDDEN = (
    # custom property of the build's collection: the characters' collection, if the build hides it
    # from renders
    "crowd_lod_hidden"
)


def hide_characters(scene: bpy.types.Scene) -> None:
    """Hide the characters themselves from renders, unless something prevents it."""
    top = scene.crowd_lod.build
    characters = scene.crowd_lod.characters
    unhide_characters(top)
    if hides_characters(scene):
        characters.hide_render = True
        top[HIDDEN] = characters


def hides_characters(scene: bpy.types.Scene) -> bool:
    """Return whether the characters of `scene` should be hidden from renders.

    Only if renders show them now.
    """
    return (
        shows_characters(scene)
        and not scene.crowd_lod.render_source_characters
        and not _shown_for(scene)
    )


def shows_characters(scene: bpy.types.Scene) -> bool:
    """Return whether renders of `scene` show the characters' own collection."""

    def shows(place: bpy.types.LayerCollection, inside: bool) -> bool:
        inside = inside or place.collection == scene.crowd_lod.characters
        below = any(shows(child, inside) for child in place.children)
        return not place.collection.hide_render and (below or (inside and not place.exclude))

    return any(shows(layer.layer_collection, False) for layer in scene.view_layers if layer.use)


def unhide_characters(top: bpy.types.Collection) -> None:
    """Show again in renders the characters that the build `top` hides.

    If another scene has a build of the same characters, they stay hidden for that one.
    """
    hidden = top.pop(HIDDEN, None)
    if not isinstance(hidden, bpy.types.Collection):  # a script may have put anything there
        return
    other_builds = [
        scene.crowd_lod.build for scene in bpy.data.scenes if scene.crowd_lod.characters == hidden
    ]
    other_builds = [other for other in other_builds if other not in (None, top)]
    if other_builds:
        other_builds[0][HIDDEN] = hidden
    else:
        hidden.hide_render = False


def _shown_for(scene: bpy.types.Scene) -> str:
    """Return why the scene's characters cannot be hidden as a whole; "" if they can."""
    characters = scene.crowd_lod.characters
    if characters.library is not None:
        return (
            f"the collection is linked from {characters.library.filepath}; hide it there, or "
            f"exclude it from the view layers"
        )
    users = bpy.data.user_map(subset={characters})[characters]
    names = [user.name for user in users if isinstance(user, bpy.types.Object | bpy.types.NodeTree)]
    others = (other for other in bpy.data.scenes if other.crowd_lod.characters != characters)
    names += [other.name for other in others if characters in other.collection.children_recursive]
    return f"{' and '.join(sorted(names))} would no longer show them" if names else ""


def notes_on_characters(scene: bpy.types.Scene) -> str:
    """Return sentences on the characters in renders of the built scene: where they went, and who
    glows.
    """
    glow = in_words(notes_on_glow(scene)) if scene.render.engine == "CYCLES" else ()
    return " ".join(filter(None, (_told_of_hiding(scene), *(line.sentence for line in glow))))


def _told_of_hiding(scene: bpy.types.Scene) -> str:
    """Return a sentence on the characters themselves; "" if Build left them as they were."""
    characters = scene.crowd_lod.characters
    if HIDDEN in scene.crowd_lod.build:
        lamps = [item.name for item in characters.all_objects if item.type == "LIGHT"]
        return (
            f"The characters in {characters.name} are hidden from "
            f"renders{', with ' + ' and '.join(lamps) if lamps else ''}."
        )
    if scene.crowd_lod.render_source_characters or not shows_characters(scene):
        return ""
    return f"The characters in {characters.name} stay in renders: {_shown_for(scene)}."
