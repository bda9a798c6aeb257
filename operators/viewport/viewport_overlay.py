"""Draws the current frame's plan in viewports, and keeps it for the sidebar.

Blender redraws a viewport after an edit in its own interface, but not after a script, an operator,
a driver or an animation has set a property of ours.
"""

import sys
import time as clock
import traceback
from dataclasses import replace

import bpy
import numpy as np

from ...crowd_lod.behavior.walk import stray_places
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.reasons import Account, account
from ..blender import scene_cache, scene_data, sidebars, steps
from ..blender.callbacks import guard
from ..blender.image_data import LOOK_AGAIN
from ..blender.stored_values import contents_of
from ..scene.characters import character_provenance
from . import character_cache, hud, inset, shader_programs, visibility
from .display import Display, display_now
from .draw_data import Style, drawing
from .gpu_batches import Batches
from .gpu_draw import paint
from .viewport_cameras import read_shutters

# The contents of each scene's settings at the last call of `has_changed`.
_known: dict[int, str] = scene_cache.add_cache({}, by_scene=True)


def has_changed(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's settings differ from those at the last call.

    False at the first call.
    """
    now = repr(contents_of(scene.crowd_lod))  # as text, where NaN equals itself
    before = _known.get(scene.session_uid, now)
    _known[scene.session_uid] = now
    return before != now


_handlers = []
_displays: dict[int, Display] = scene_cache.add_cache({}, by_scene=True)
WATCH = 0.25  # seconds between two looks for changes that Blender gives no notice of
_failure: str | None = None


def register() -> None:
    global _failure
    _failure = None
    if not bpy.app.background:  # nothing is drawn there
        for part, when in ((_draw_crowd, "POST_VIEW"), (_draw_figures, "POST_PIXEL")):
            _handlers.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (part,), "WINDOW", when))
        bpy.app.timers.register(_watch, first_interval=WATCH, persistent=True)


def unregister() -> None:
    _let_go()
    for timer in TIMERS:
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)


def _let_go() -> None:
    """Remove the draw handlers; drop the caches of scenes and the shader programs."""
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
    scene_cache.forget()
    shader_programs.forget()


@guard
def _stop() -> None:
    """Timer: remove the draw handlers, which must not be done while Blender draws."""
    _let_go()
    sidebars.redraw()


def latest(scene: bpy.types.Scene) -> Frame | None:
    """Return the frame that the viewport shows of `scene`, or None."""
    display = display_of(scene)
    return display and display.frame


def display_of(scene: bpy.types.Scene) -> Display | None:
    """Return what the viewport shows of `scene`.

    None while the overlay is off, or before it was first drawn.
    """
    return _displays.get(scene.session_uid) if scene.crowd_lod.overlay else None


def problem(scene: bpy.types.Scene) -> str | None:
    """Return a sentence that says why nothing is drawn for `scene`, or None."""
    display = display_of(scene)
    return _failure or (display and display.problem)


def undrawn(scene: bpy.types.Scene) -> str:
    """Return a sentence that says why the viewport shows no frame of `scene`; "" if it does."""
    return "" if latest(scene) is not None else problem(scene) or "The overlay was not drawn yet"


def account_of(scene: bpy.types.Scene) -> Account | None:
    """Return the account of the agent picked in the scene's settings, or None."""
    display = display_of(scene)
    agent = scene.crowd_lod.agent
    if display is None or display.frame is None or not 0 <= agent < len(display.frame.crowd):
        return None
    picked = account(display.frame, agent)
    return replace(picked, depth=picked.depth * scene_data.meters(scene))


def steps_back(context) -> str:
    """Return a sentence if the viewport shows the build instead of the overlay's crowd; or ""."""
    shows = visibility.shows_build(context.scene.crowd_lod, context.view_layer, context.space_data)
    return visibility.STEPS_BACK if shows else ""


def _draw(part) -> None:
    """Draw handler: call `part`; on any error print it once and stop the overlay."""
    global _failure
    context = bpy.context
    settings = context.scene.crowd_lod
    space = context.space_data
    if _failure or steps.renders() or not settings.overlay or not space.overlay.show_overlays:
        return
    try:
        if visibility.shows_crowd(settings, space):
            part(context)
    except Exception as error:
        traceback.print_exc()
        _failure = (
            f"The overlay stopped ({error}): disable and enable Crowd LOD to start it "
            f"again; see the console for details."
        )
        print(f"Crowd LOD: {_failure}", file=sys.stderr)
        bpy.app.timers.register(_stop)


def _draw_crowd(context) -> None:
    """POST_VIEW handler: draw the crowd."""
    began = clock.monotonic()
    display = follow(context)
    display.draw_began = began
    if display.batches is not None and not steps_back(context):
        view = context.region_data
        region = context.region
        paint(
            display.batches,
            np.array(view.view_matrix, np.float64),
            np.array(view.window_matrix, np.float64),
            (region.width, region.height),
            context.preferences.system.ui_scale,
        )


def _draw_figures(context) -> None:
    """POST_PIXEL handler: draw text, ring and inset over the crowd just drawn."""
    scene = context.scene
    region = context.region
    display = _displays.get(scene.session_uid)
    settings = scene.crowd_lod
    ui_scale = context.preferences.system.ui_scale
    if (
        display is None
        or display.frame is None
        or not (settings.hud or settings.inset or settings.agent >= 0)
    ):
        return
    box = hud.free_box(context.area, region, context.space_data.overlay, ui_scale)
    # of the four views of a quad view, only the one that turns freely has text and inset
    main = context.region_data == context.space_data.region_3d
    above = picture_from_above(display, ui_scale) if settings.inset and main else None
    account = account_of(scene)
    if account is not None:
        hud.ring(display.frame, account.agent, region, ui_scale)
    legend = box[0], box[3]
    lines: tuple[hud.HudLine, ...] = ()
    if settings.hud:
        notes = (*display.notes, *filter(None, [steps_back(context)]))
        lines = hud.figures(display.frame, display.colors, notes, display.worst)
    if account is not None:
        lines = (*lines, hud.line_of(account, display.colors))
    if lines and main:
        legend = hud.write(lines, box, ui_scale)
    if above is not None:
        inset.show(above, box, legend, ui_scale, scene_data.meters(scene))


def picture_from_above(display: Display, ui_scale: float) -> inset.Above:
    """Return the picture of the frame from above, painted once per frame."""
    size = inset.pixels(ui_scale)
    if display.above is None or display.above.size != size:
        trajectory = display.frame.trajectory
        points = inset.with_strays(
            drawing(display.frame, Style("POINTS"), display.colors), stray_places(trajectory)
        )
        places = np.concatenate([points.positions, points.lines.reshape(-1, 3), np.zeros((1, 3))])
        view, projection = inset.from_above(trajectory.area, points.origin, places)
        texture = inset.picture(Batches(points), view, projection, ui_scale)
        width = float(2 / projection[0, 0])
        display.above = inset.Above(texture, width, inset.captions(display.colors))
    return display.above


def follow(context) -> Display:
    """Return what to show of the context's scene; compute only what has changed."""
    scene = context.scene
    before = _displays.get(scene.session_uid)
    display = before if _stays(scene, before) else display_now(context, before)
    if display is not before:
        scene_cache.tidy()
        _displays[scene.session_uid] = display
        _redraw_sidebars_soon()
    return display


def _stays(scene: bpy.types.Scene, display: Display | None) -> bool:
    """Return whether the viewport shows what it did, as a step is at work.

    Steps go through frames, and change data, only for a while. Who looks around with the
    viewport's own camera is followed.
    """
    is_shown = display is not None and display.frame is not None
    return bool(steps.at_work()) and is_shown and scene.crowd_lod.overlay_camera != "VIEWPORT"


@guard(failed=WATCH)
def _watch() -> float:
    """Timer: redraw viewports that are out of date without Blender's notice.

    They are if settings have changed, or if the last drawing did not compare the crowd with its
    sources (see _crowd_of) and LOOK_AGAIN seconds have passed. Returns seconds to the next call.
    """
    scenes = {window.scene for window in bpy.context.window_manager.windows}
    for scene in scenes if not steps.at_work() else ():
        display = display_of(scene)
        is_due = (
            display is not None
            and display.frame is not None
            and display.looked < display.draw_began
            and clock.monotonic() > display.looked + LOOK_AGAIN + WATCH
        )
        if has_changed(scene) or is_due:
            sidebars.redraw_viewports()
    return WATCH


def _redraw_sidebars_soon() -> None:
    # by a timer: Blender forgets a request made while it draws
    if not bpy.app.timers.is_registered(sidebars.redraw):
        bpy.app.timers.register(sidebars.redraw)


# What may still be due when the extension is disabled.
TIMERS = (
    _watch,
    sidebars.redraw,
    read_shutters,
    _stop,
    character_cache.bake_some,
    character_provenance.read_some,
)
