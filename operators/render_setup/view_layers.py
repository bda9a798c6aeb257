"""Where the build and its characters are shown: view layers and their exclusions."""

from collections.abc import Sequence

import bpy

from ...crowd_lod.errors import CrowdError


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
