"""Where the build is shown, and that the characters themselves are hidden from its renders."""

from collections.abc import Sequence

import bpy

from ...crowd_lod.errors import CrowdError
from ..scene.characters.characters import notes_on_glow
from ..settings.messages import in_words


def exclude(layer: bpy.types.LayerCollection, collection: bpy.types.Collection) -> None:
    """Exclude the `collection` from the view layer, wherever it is in `layer`."""
    for child in layer.children:
        if child.collection == collection:
            child.exclude = True
        exclude(child, collection)


def layers_of(scene: bpy.types.Scene) -> dict[str, bpy.types.LayerCollection]:
    """Return the layer collection of the scene's build by view layer name.

    Its `exclude` says whether the build is shown there. Empty where the user has moved the build
    out of the scene.
    """
    layers = {}
    for layer in scene.view_layers:
        places = [layer.layer_collection]
        while places:
            place = places.pop()
            places += place.children
            if place.collection == scene.crowd_lod.build:
                layers[layer.name] = place
    return layers


def show_in(scene: bpy.types.Scene, names: Sequence[str]) -> None:
    """Show the scene's build only in the view layers `names`; other settings stay."""
    for name, place in layers_of(scene).items():
        if place.exclude != (name not in names):
            place.exclude = not place.exclude


def show_where_characters_are(scene: bpy.types.Scene) -> None:
    """Show a new build of the scene as its view layers show the characters.

    A layer that excludes the characters excludes the build; one where they are held out, or in
    sight of indirect rays alone, treats the build alike. Characters that no layer shows are hidden
    for being the build's source: it is then shown in all layers.
    """
    characters = {
        layer.name: _ways_to(layer.layer_collection, scene.crowd_lod.characters)
        for layer in scene.view_layers
    }
    builds = layers_of(scene)
    showing = [name for name, ways in characters.items() if any(map(_shows, ways))]
    for name in showing:
        shown = [way for way in characters[name] if _shows(way)]
        for setting in ("holdout", "indirect_only"):
            if all(any(getattr(place, setting) for place in way) for way in shown):
                setattr(builds[name], setting, True)
    if showing:
        show_in(scene, showing)


def _ways_to(
    place: bpy.types.LayerCollection, collection: bpy.types.Collection
) -> list[tuple[bpy.types.LayerCollection, ...]]:
    """Return the ways down the layer from `place` to each place of the `collection`."""
    if place.collection == collection:
        return [(place,)]
    return [(place, *way) for child in place.children for way in _ways_to(child, collection)]


def _shows(way: tuple[bpy.types.LayerCollection, ...]) -> bool:
    """Return whether the view layer has objects of the way's last place, or below it."""
    *_, place = way
    own = not place.exclude and len(place.collection.objects) > 0
    return own or any(_shows((child,)) for child in place.children)


def check_layers(scene: bpy.types.Scene, names: Sequence[str]) -> None:
    """Raise CrowdError if `scene` lacks a view layer of the `names`."""
    for name in names:
        if name not in scene.view_layers:
            known = ", ".join(layer.name for layer in scene.view_layers)
            raise CrowdError(
                f"The scene {scene.name} has no view layer {name}: give one of {known}."
            )


# custom property of the build's collection: the characters' collection, if the build hides it from
# renders
HIDDEN = "crowd_lod_hidden"


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
        with_lamps = f", with {' and '.join(lamps)}" if lamps else ""
        return f"Source characters are hidden in renders{with_lamps}."
    if scene.crowd_lod.render_source_characters or not shows_characters(scene):
        return ""
    return f"Source characters stay in renders: {_shown_for(scene)}."
