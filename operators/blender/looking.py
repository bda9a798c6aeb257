"""While a step works, the user looks and does not touch: which events of a window only look."""

import bpy

MOVING = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE"}
NAVIGATION = {
    *("MIDDLEMOUSE", "MOUSEROTATE", "MOUSESMARTZOOM", "TRACKPADPAN", "TRACKPADZOOM"),
    *("WHEELUPMOUSE", "WHEELDOWNMOUSE", "WHEELINMOUSE", "WHEELOUTMOUSE"),
    *("WHEELLEFTMOUSE", "WHEELRIGHTMOUSE"),
}
# of a 3D mouse, but its menu and its keys
NDOF = "NDOF_MOTION", "NDOF_BUTTON_"
NDOF_KEYS = "NDOF_BUTTON_MENU", "NDOF_BUTTON_SAVE_"
# of a 3D viewport alone: elsewhere some of them change the field under the mouse
VIEW_KEYS = {
    *(f"NUMPAD_{number}" for number in range(10)),
    *("NUMPAD_PERIOD", "NUMPAD_PLUS", "NUMPAD_MINUS", "HOME"),
}


def only_looks(window: bpy.types.Window, event: bpy.types.Event) -> bool:
    """Return whether the event, of the window, changes at most what the user looks at.

    With Ctrl or Alt most change something: Alt and the wheel the frame, Ctrl and the wheel the
    field under the mouse, Ctrl Numpad 0 the camera. So does all navigation through a camera that
    is locked to the view.
    """
    kind = event.type
    if kind in MOVING or kind.startswith("TIMER"):
        return True
    is_dolly = kind == "MIDDLEMOUSE" and not event.alt
    if event.oskey or (event.alt or event.ctrl) and not is_dolly:
        return False
    viewport = _viewport_under(window, event)
    if viewport is not None and _moves_camera(viewport):
        return False
    is_3d_mouse = kind.startswith(NDOF) and not kind.startswith(NDOF_KEYS)
    return kind in NAVIGATION or is_3d_mouse or (kind in VIEW_KEYS and viewport is not None)


def _viewport_under(
    window: bpy.types.Window, event: bpy.types.Event
) -> bpy.types.SpaceView3D | None:
    """Return the 3D viewport under the mouse; None in its sidebar and headers, or elsewhere."""
    for area in window.screen.areas:
        over = [
            region.type
            for region in area.regions
            if 0 <= event.mouse_x - region.x < region.width
            and 0 <= event.mouse_y - region.y < region.height
        ]
        if area.type == "VIEW_3D" and set(over) == {"WINDOW"}:
            return area.spaces.active
    return None


def _moves_camera(viewport: bpy.types.SpaceView3D) -> bool:
    views = viewport.region_3d, *viewport.region_quadviews
    return viewport.lock_camera and any(view.view_perspective == "CAMERA" for view in views)


def stop_playback() -> None:
    """Stop the animation that any window plays."""
    for window in bpy.context.window_manager.windows:
        if window.screen.is_animation_playing:
            with bpy.context.temp_override(window=window, screen=window.screen):
                bpy.ops.screen.animation_cancel(restore_frame=False)
