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
    found = {}
    for layer in scene.view_layers:
        places = [layer.layer_collection]
        while places:
            place = places.pop()
            places += place.children
            if place.collection == scene.crowd_lod.build:
                found[layer.name] = place
    return found


def show_in(scene: bpy.types.Scene, names: Sequence[str]) -> None:
    """Show the scene's build only in the view layers `names`; other settings stay."""
    for name, place in layers_of(scene).items():
        if place.exclude != (name not in names):
            place.exclude = not place.exclude


def check_layers(scene: bpy.types.Scene, names: Sequence[str]) -> None:
    """Raise CrowdError if `scene` lacks a view layer of the `names`."""
    for name in names:
        if name not in scene.view_layers:
            known = ", ".join(layer.name for layer in scene.view_layers)
            raise CrowdError(f"The scene {scene.name} has no view layer {name}: give one of {known}.")
