"""Whether a viewport shows the overlay's characters, by what else it shows."""

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
    return any(item.visible_get(view_layer=layer, viewport=space) and item.visible_in_viewport_get(space) for item in points)
