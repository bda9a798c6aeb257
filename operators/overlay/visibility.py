"""What shows beside the overlay: whether a viewport shows its characters, and what its pictures
show.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

STEPS_BACK = "The build shows here, so the overlay draws no characters."


def shows_crowd(settings, space: bpy.types.SpaceView3D) -> bool:
    """Return whether the viewport shows the crowd: in local view only with some of its objects.

    Those are the objects of the characters and of the build.
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
def revealed(scene: bpy.types.Scene) -> Iterator[None]:
    """Show what the scene's viewports hide by a setting that they share with those of other scenes.

    Hide it again at the end.

    Those are collections and objects disabled in viewports.
    """
    hidden = [
        each
        for each in (*scene.collection.children_recursive, *scene.objects)
        if each.hide_viewport
    ]
    try:
        for each in hidden:
            each.hide_viewport = False
        yield
    finally:
        for each in hidden:
            each.hide_viewport = True


def show_as_rendered(layer: bpy.types.ViewLayer) -> None:
    """Let viewports show of the view layer only what its renders show, and what `revealed` shows.

    The view layer's own settings change. Those of objects may be animated: they count as they are
    now.
    """
    _show(layer.layer_collection)
    layer.depsgraph.update()
    for item in layer.objects:
        item.hide_set(item.evaluated_get(layer.depsgraph).hide_render, view_layer=layer)
    layer.depsgraph.update()


def _show(place: bpy.types.LayerCollection) -> None:
    """Exclude from the view layer the collections in `place` that renders hide, and show the
    others.
    """
    for child in place.children:
        if child.exclude:
            continue
        if child.collection.hide_render:
            child.exclude = True
        else:
            child.hide_viewport = False
            _show(child)
