"""What a viewport shows besides the overlay: the crowd's own objects, the build, hidden objects."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..blender.removal import is_there

STEPS_BACK = "Overlay hidden while the build is visible."


def shows_crowd(settings, space: bpy.types.SpaceView3D) -> bool:
    """Return whether the viewport shows the crowd.

    A local view shows it only with an object of the characters or of the build.
    """
    if space.local_view is None:
        return True
    tops = filter(None, (settings.characters, settings.build))
    return any(item.local_view_get(space) for top in tops for item in top.all_objects)


def shows_build(settings, layer: bpy.types.ViewLayer, space: bpy.types.SpaceView3D) -> bool:
    """Return whether the viewport shows a point object of the build.

    Not where the view layer excludes or hides it, or where the viewport hides it: by object type,
    local view or local collections.
    """
    points = settings.build.objects if settings.build is not None else ()
    return any(
        item.visible_get(view_layer=layer, viewport=space) and item.visible_in_viewport_get(space)
        for item in points
    )


@contextmanager
def reveal_hidden(scene: bpy.types.Scene) -> Iterator[None]:
    """Show collections and objects of the scene that are disabled in viewports; hide them again.

    This setting holds for the viewports of all scenes.
    """
    hidden = [
        item
        for item in (*scene.collection.children_recursive, *scene.objects)
        if item.hide_viewport
    ]
    try:
        for item in hidden:
            item.hide_viewport = False
        yield
    finally:
        for item in filter(is_there, hidden):
            item.hide_viewport = True


def show_as_rendered(layer: bpy.types.ViewLayer) -> None:
    """Let viewports show of the view layer what its renders show, and nothing else.

    Inside `reveal_hidden`. It changes settings of the view layer. Objects are shown or hidden as
    they are at the current frame, since their settings may be animated.
    """
    _show(layer.layer_collection)
    layer.depsgraph.update()
    for item in layer.objects:
        item.hide_set(item.evaluated_get(layer.depsgraph).hide_render, view_layer=layer)
    layer.depsgraph.update()


def _show(place: bpy.types.LayerCollection) -> None:
    """Exclude the collections in `place` that renders hide from the view layer; show the others."""
    for child in place.children:
        if child.exclude:
            continue
        if child.collection.hide_render:
            child.exclude = True
        else:
            child.hide_viewport = False
            _show(child)
