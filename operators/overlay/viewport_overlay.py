"""Draws the current frame's plan in viewports, and keeps it for the sidebar."""

import sys
import time as clock
import traceback
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...crowd_lod.behavior.walk import stray_places
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.agent_under_cursor import Account, account
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.hysteresis import hold_levels
from ...crowd_lod.frame.request import Request
from ...crowd_lod.levels.assignment import Bias
from ..blender import frame_stepping, image_data, scene_cache, scene_data, sidebars
from ..blender.cameras import read_cameras, read_shutter
from ..blender.guard import guarded
from ..blender.image_data import LOOK_AGAIN
from ..characters.stored_groups import groups_of
from ..machine.scene_world import bias_of
from ..scene.scene_crowd import policy_of, trajectory_of
from ..scene.shot_exceptions import drawn_inputs
from ..scene.shot_reference import reference, use_of
from ..sources.crowd_sources import inputs_of, live
from . import (
    agent_colors,
    character_cache,
    gpu_culling,
    hud,
    inset,
    redraw,
    shader_programs,
    visibility,
)
from .appearance import cast_of, colors_of, drawing_of, missing_groups, style_of
from .draw_data import Style, drawing
from .gpu_draw import Batches, Cast, paint
from .viewport_camera import viewpoint

if TYPE_CHECKING:
    from gpu.types import GPUTexture


@dataclass
class Shown:
    """What the viewport shows of a scene: a frame, or a problem.

    crowd_inputs, frame_inputs, cast_inputs: the values that the frame's trajectory and bias, the
        frame, and the cast depend on; compared to find changes.
    looked: time in seconds when the trajectory was last compared with the map and the state
        machine.
    colored: the agents' colors.
    cast, batches: on the GPU.
    prepared: milliseconds to upload them.
    painted: milliseconds to submit one draw of them.
    drawn: time in seconds when its last drawing began.
    above: texture of the frame from above, once it was needed.
    notes: sentences for the user.
    problem: a sentence for the user, if nothing can be shown.
    """

    crowd_inputs: tuple = ()
    frame_inputs: tuple = ()
    cast_inputs: tuple = ()
    looked: float = 0.0
    frame: Frame | None = None
    colored: agent_colors.Colors | None = None
    cast: Cast | None = None
    batches: Batches | None = None
    prepared: float = 0.0
    painted: float = 0.0
    drawn: float = 0.0
    above: object = None
    notes: tuple[str, ...] = ()
    problem: str | None = None


_handlers = []
_shown: dict[int, Shown] = scene_cache.add_cache({}, by_scene=True)
WATCH = 0.25  # seconds between two looks for changes that Blender does not tell
REST = 0.3  # seconds that a frame is shown before its open shutter is asked for
# Of scenes with motion blur: (what an open shutter is asked for, since when, seconds), and (that,
# read_shutter's answer).
_asked: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)
_shutters: dict[int, tuple] = scene_cache.add_cache({}, by_scene=True)
_faster = scene_cache.add_cache(gpu_culling.Faster())
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
    for timer in (_watch, sidebars.redraw, _read_shutters, _stop, character_cache.bake_some):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)


def _let_go() -> None:
    """Remove the draw handlers; drop the caches of scenes and the shader programs."""
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
    scene_cache.forget()
    shader_programs.forget()


@guarded
def _stop() -> None:
    """Timer: remove the draw handlers, which must not be done while Blender draws."""
    _let_go()
    sidebars.redraw()


def latest(scene: bpy.types.Scene) -> Frame | None:
    """Return the frame that the viewport shows of `scene`, or None."""
    shown = shown_of(scene)
    return shown and shown.frame


def shown_of(scene: bpy.types.Scene) -> Shown | None:
    """Return what the viewport shows of `scene`.

    None while the overlay is off, or before it was first drawn.
    """
    return _shown.get(scene.session_uid) if scene.crowd_lod.overlay else None


def problem(scene: bpy.types.Scene) -> str | None:
    """Return a sentence that says why nothing is drawn for `scene`, or None."""
    shown = shown_of(scene)
    return _failure or (shown and shown.problem)


def undrawn(scene: bpy.types.Scene) -> str:
    """Return a sentence that says why the viewport shows no frame of `scene`; "" if it does."""
    return "" if latest(scene) is not None else problem(scene) or "The overlay was not drawn yet"


def account_of(scene: bpy.types.Scene) -> Account | None:
    """Return the account of the agent picked in the scene's settings, or None."""
    display = shown_of(scene)
    agent = scene.crowd_lod.agent
    if display is None or display.frame is None or not 0 <= agent < len(display.frame.crowd):
        return None
    found = account(display.frame, agent)
    return replace(found, depth=found.depth * scene_data.meters(scene))


def steps_back(context) -> str:
    """Return a sentence if the context's viewport shows the build, and so no characters of the
    overlay.

    Else "".
    """
    shows = visibility.shows_build(context.scene.crowd_lod, context.view_layer, context.space_data)
    return visibility.STEPS_BACK if shows else ""


def _draw(part) -> None:
    """Draw handler: call `part`; on any error print it once and stop the overlay."""
    global _failure
    context = bpy.context
    settings = context.scene.crowd_lod
    space = context.space_data
    if _failure or not settings.overlay or not space.overlay.show_overlays:
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
    drawn = clock.monotonic()
    display = _follow(context)
    display.drawn = drawn
    if display.batches is not None and not steps_back(context):
        view = context.region_data
        region = context.region
        began = clock.perf_counter()
        paint(
            display.batches,
            np.array(view.view_matrix, np.float64),
            np.array(view.window_matrix, np.float64),
            (region.width, region.height),
            context.preferences.system.ui_scale,
        )
        display.painted = 1000 * (clock.perf_counter() - began)


def _draw_figures(context) -> None:
    """POST_PIXEL handler: draw text, ring and inset over the crowd just drawn."""
    scene = context.scene
    region = context.region
    display = _shown.get(scene.session_uid)
    settings = scene.crowd_lod
    ui_scale = context.preferences.system.ui_scale
    if (
        display is None
        or display.frame is None
        or not (settings.hud or settings.inset or settings.agent >= 0)
    ):
        return
    box = hud.free_box(context.area, region, context.space_data.overlay, ui_scale)
    # of a quad view only the one that turns freely
    main = context.region_data == context.space_data.region_3d
    above = _picture_from_above(display, ui_scale) if settings.inset and main else None
    account = account_of(scene)
    if account is not None:
        hud.ring(display.frame, account.agent, region, ui_scale)
    legend = box[0], box[3]
    if settings.hud and main:
        gpu_bytes = sum(
            each.nbytes for each in (display.batches, display.cast) if each
        ) + inset.nbytes(display.above)
        notes = (*display.notes, *filter(None, [steps_back(context)]))
        lines = hud.figures(
            display.frame,
            display.colored,
            display.prepared + display.painted,
            gpu_bytes,
            account,
            notes,
        )
        legend = hud.write(lines, box, ui_scale)
    if above is not None:
        inset.show(above, box, legend, ui_scale)


def _picture_from_above(display: Shown, ui_scale: float) -> "GPUTexture":
    """Return the texture of the frame from above, painted once per frame."""
    if display.above is None or (display.above.width, display.above.height) != inset.pixels(
        ui_scale
    ):
        trajectory = display.frame.trajectory
        what = inset.with_strays(
            drawing(display.frame, Style("POINTS"), display.colored), stray_places(trajectory)
        )
        places = np.concatenate([what.positions, what.lines.reshape(-1, 3), np.zeros((1, 3))])
        view, projection = inset.from_above(trajectory.area, what.origin, places)
        display.above = inset.picture(Batches(what), view, projection, ui_scale)
    return display.above


def _follow(context) -> Shown:
    """Return what to show of the context's scene; compute only what has changed."""
    scene = context.scene
    before = _shown.get(scene.session_uid)
    display = _shown_now(context, before)
    if display is not before:
        scene_cache.tidy()
        _shown[scene.session_uid] = display
        _redraw_sidebars_soon()
    return display


def _shown_now(context, before: Shown | None) -> Shown:
    scene = context.scene
    depsgraph = context.view_layer.depsgraph
    looked = clock.monotonic()
    try:
        crowd_inputs = _crowd_inputs(scene)
        settings = scene.crowd_lod
        region = context.region.as_pointer() if settings.overlay_camera == "VIEWPORT" else None
        eyes = (viewpoint(context),) if region is not None else read_cameras(scene, depsgraph)
        policy = replace(policy_of(settings), hysteresis=round(settings.hysteresis, 6))
        time = scene_data.time_of(scene)
        key, shutter = (
            ((), ()) if region is not None or live(settings) else _open_shutter(scene, time, eyes)
        )
        frame_inputs = region, time, policy, *map(_values, eyes), key if shutter else ()
        style, characters, notes = style_of(scene, policy.count)
        notes = missing_groups(settings) or notes  # LODs are made for the names that Populate gives
        frame_inputs += (
            style,
            notes,
            settings.overlay_color,
            round(settings.overlay_fade, 6),
            reference(settings),
        )
        frame_inputs += drawn_inputs(settings)
        same_frame = (
            before.frame if before is not None and before.crowd_inputs == crowd_inputs else None
        )
        if same_frame is not None and looked < before.looked + LOOK_AGAIN and not live(settings):
            trajectory = same_frame.trajectory
            bias = same_frame.bias
            looked = before.looked
        else:
            trajectory = trajectory_of(scene, depsgraph=depsgraph)
            bias = bias_of(settings)
            if same_frame is not None and _same(bias, same_frame.bias):
                bias = same_frame.bias
        cast_inputs = trajectory.groups, style.mode, characters
        same_cast = before is not None and before.cast_inputs == cast_inputs
        same_crowd = same_frame is not None and trajectory is same_frame.trajectory
        if (
            same_crowd
            and bias is same_frame.bias
            and before.frame_inputs == frame_inputs
            and same_cast
        ):
            before.looked = looked
            return before
        use = use_of(settings, trajectory, policy, bias, time, eyes if region is None else ())
        request = Request(
            time=time, eyes=tuple(eyes), policy=policy, shutter=tuple(shutter), bias=bias
        )
        frame = use.applied(_faster.plan_of(trajectory, request))
        same_view = before is not None and before.frame_inputs[:1] == (region,)
        if policy.hysteresis and same_view and same_crowd and frame.plan_row is None:
            frame = hold_levels(frame, same_frame.levels)
        began = clock.perf_counter()
        cast = before.cast if same_cast else cast_of(trajectory.groups, style, characters)
        colored = colors_of(settings.overlay_color, frame, characters)
        framed = region is None  # else its frustum is the viewport's edge
        what = drawing_of(settings, frame, style, colored, framed)
        batches = Batches(what, cast, before and before.batches)
        return Shown(
            crowd_inputs=crowd_inputs,
            frame_inputs=frame_inputs,
            cast_inputs=cast_inputs,
            looked=looked,
            frame=frame,
            colored=colored,
            cast=cast,
            batches=batches,
            prepared=1000 * (clock.perf_counter() - began),
            notes=(*notes, *filter(None, [frame.unplanned])),
        )
    except CrowdError as error:
        if before is not None and before.problem == str(error):
            return before
        return Shown(problem=str(error))


def _crowd_inputs(scene) -> tuple:
    """Return the inputs of trajectory and bias, except image pixels."""
    settings = scene.crowd_lod
    bias = settings.bias_image and settings.bias_image.session_uid
    return groups_of(settings), bias, *inputs_of(scene)


def _values(camera: Camera) -> tuple:
    """Return all fields of the camera as values that can be compared."""
    found = (getattr(camera, each.name) for each in fields(camera))
    return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in found)


def _same(first: Bias | None, second: Bias | None) -> bool:
    if first is None or second is None:
        return first is second
    return first.area == second.area and np.array_equal(first.values, second.values)


def _open_shutter(scene, time: float, eyes: tuple[Camera, ...]) -> tuple:
    """Return (key, read_shutter's answer); the answer is () while it is not known.

    Reading other times needs a temporary scene, which must not be made while Blender draws. So a
    timer reads them and redraws the viewport. The frame after that takes long (see
    frame_stepping.stage), so frames that pass quickly are shown without it.
    If the camera's motion is edited only at other times, the change shows once the frame or the
    camera changes.
    """
    render = scene.render
    if not render.use_motion_blur:
        return (), ()
    key = time, render.motion_blur_position, render.motion_blur_shutter, *map(_values, eyes)
    known, samples = _shutters.get(scene.session_uid, ((), ()))
    if known == key:
        return key, samples
    if _asked.get(scene.session_uid, ((),))[0] != key:
        _asked[scene.session_uid] = key, clock.monotonic()
    if not bpy.app.timers.is_registered(_read_shutters):
        bpy.app.timers.register(_read_shutters)
    return key, ()


@guarded
def _read_shutters() -> float | None:
    """Timer: read the shutters asked for.

    Returns seconds to the next call, or None if done.
    Waits while an animation plays or the frame has just changed: the next frame would ask again.
    """
    if image_data.playing():
        return LOOK_AGAIN
    rest = max((since for _, since in _asked.values()), default=-np.inf) + REST - clock.monotonic()
    if rest > 0:
        return rest
    for scene in bpy.data.scenes:
        key, _ = _asked.pop(scene.session_uid, (None, None))
        if key is not None:
            try:
                # stepped, the scene would lose what the user has not keyed yet
                with frame_stepping.stage() as at:
                    _shutters[scene.session_uid] = key, read_shutter(scene, key[0], at)
            except CrowdError:  # the drawing itself says so
                _shutters[scene.session_uid] = key, ()
    _asked.clear()
    redraw.viewports()
    return None


@guarded(failed=WATCH)
def _watch() -> float:
    """Timer: have viewports drawn again that are old without Blender's notice.

    Either settings have changed, or what is looked at only every LOOK_AGAIN seconds was not looked
    at in the last drawing. Returns seconds to the next call.
    """
    for scene in {window.scene for window in bpy.context.window_manager.windows}:
        shown = shown_of(scene)
        due = shown is not None and shown.frame is not None and shown.looked < shown.drawn
        if redraw.changed(scene) or (due and clock.monotonic() > shown.looked + LOOK_AGAIN + WATCH):
            redraw.viewports()
    return WATCH


def _redraw_sidebars_soon() -> None:
    # from within a drawing Blender would forget the request
    if not bpy.app.timers.is_registered(sidebars.redraw):
        bpy.app.timers.register(sidebars.redraw)
