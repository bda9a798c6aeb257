"""The viewport overlay: draws the current frame's plan, and keeps it for the sidebar."""

import sys
import time as clock
import traceback
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path

import bpy
import numpy as np

from ..crowd_lod.behaviour import Trajectory
from ..crowd_lod.camera import Camera
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.frame import Frame, plan
from ..crowd_lod.levels import Bias
from ..crowd_lod.live import held
from .cameras import read_cameras, read_shutter
from .points import Drawing, drawing
from .populate import bias_of, groups_of, policy_of, trajectory_of

SHADERS = Path(__file__).parent.parent / "shaders"
POINT_PIXELS = 4.0, 14.0  # least and greatest width of a visible agent's point
LINE_PIXELS = 1.5
# Seconds between two looks at what has no cheap mark of change: the map's pixels, the state machine's text.
LOOK_AGAIN = 1.0


@dataclass
class Shown:
    """What the viewport shows of a scene: a frame of a trajectory, or a problem, ready for the user.

    crowd_inputs, frame_inputs: what it follows from, as values that compare. looked: when the trajectory was last
    compared with the map and the state machine, seconds. batches: on the GPU.
    """

    crowd_inputs: tuple = ()
    frame_inputs: tuple = ()
    looked: float = 0.0
    trajectory: Trajectory | None = None
    bias: Bias | None = None
    frame: Frame | None = None
    batches: "Batches | None" = None
    problem: str | None = None


_handlers = []
_shaders = {}
_shown: dict[int, Shown] = {}  # by the scene's session_uid
# Of scenes with motion blur, by session_uid: what an open shutter is asked for, and (that, read_shutter's answer).
_asked: dict[int, tuple] = {}
_shutters: dict[int, tuple] = {}
_failure: str | None = None


def register():
    global _failure
    _failure = None
    if not bpy.app.background:  # nothing is drawn there
        _handlers.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW"))


def unregister():
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
    for kept in (_shown, _shaders, _asked, _shutters):
        kept.clear()
    for timer in (_redraw_sidebars, _read_shutters):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)


def latest(scene: bpy.types.Scene) -> Frame | None:
    """The frame that the viewport shows of `scene`, or None."""
    shown = shown_of(scene)
    return shown and shown.frame


def shown_of(scene: bpy.types.Scene) -> Shown | None:
    """What the viewport shows of `scene`; None while its overlay is off, or was never drawn."""
    return _shown.get(scene.session_uid) if scene.crowd_lod.overlay else None


def problem(scene: bpy.types.Scene) -> str | None:
    """A sentence saying why nothing is drawn for `scene`, or None."""
    shown = shown_of(scene)
    return _failure or (shown and shown.problem)


def _draw():
    """POST_VIEW: whatever goes wrong ends here, and is told once."""
    global _failure
    context = bpy.context
    if not context.scene.crowd_lod.overlay or not context.space_data.overlay.show_overlays:
        return
    try:
        batches = _follow(context).batches
        if batches is not None:
            paint(batches, context.preferences.system.ui_scale)
    except Exception as error:
        traceback.print_exc()
        _failure = (
            f"The overlay stopped ({error}): disable and enable Crowd LOD to start it again; the console has more."
        )
        print(f"Crowd LOD: {_failure}", file=sys.stderr)
        unregister()
        _redraw_sidebars_soon()


def _follow(context) -> Shown:
    """What to show of the context's scene, computed only where its inputs have changed."""
    scene = context.scene
    before = _shown.get(scene.session_uid)
    shown = _shown_now(scene, context.view_layer.depsgraph, before)
    if shown is not before:
        for gone in _shown.keys() - {each.session_uid for each in bpy.data.scenes}:
            del _shown[gone]
            _shutters.pop(gone, None)
        _shown[scene.session_uid] = shown
        _redraw_sidebars_soon()
    return shown


def _shown_now(scene, depsgraph, before: Shown | None) -> Shown:
    looked = clock.monotonic()
    try:
        crowd_inputs = _crowd_inputs(scene)
        settings, eyes = scene.crowd_lod, read_cameras(scene, depsgraph)
        policy = replace(policy_of(settings), hysteresis=round(settings.hysteresis, 6))
        time = scene.frame_current + scene.frame_subframe
        key, shutter = _open_shutter(scene, time, eyes)
        frame_inputs = time, policy, *map(_values, eyes), key if shutter else ()
        known = before.trajectory if before is not None and before.crowd_inputs == crowd_inputs else None
        if known is not None and looked < before.looked + LOOK_AGAIN:
            trajectory, bias, looked = known, before.bias, before.looked
        else:
            trajectory = trajectory_of(scene)
            bias = bias_of(settings, trajectory.world.area)
            if known is not None and _same(bias, before.bias):
                bias = before.bias
        if trajectory is known and bias is before.bias and before.frame_inputs == frame_inputs:
            before.looked = looked
            return before
        frame = plan(trajectory, eyes, policy, time, shutter, bias)
        if policy.hysteresis and before is not None and before.trajectory is trajectory:
            frame = held(frame, before.frame.levels, trajectory.groups, eyes, policy, bias)
        batches = Batches(drawing(frame, trajectory.groups))
        return Shown(crowd_inputs, frame_inputs, looked, trajectory, bias, frame, batches)
    except CrowdError as error:
        if before is not None and before.problem == str(error):
            return before
        return Shown(problem=str(error))


def _crowd_inputs(scene) -> tuple:
    """What trajectory and bias follow from, but for the images' pixels and the state machine's text."""
    settings = scene.crowd_lod
    chosen = settings.map_image, settings.machine, settings.height_image, settings.bias_image
    blocks = (block and block.session_uid for block in chosen)
    numbers = settings.count, settings.seed, settings.first_frame, scene.render.fps, scene.render.fps_base
    return groups_of(settings), *blocks, *numbers, *settings.centre, *settings.size, settings.height_scale, settings.tilt


def _values(camera: Camera) -> tuple:
    """All of the camera, as values that compare."""
    found = (getattr(camera, each.name) for each in fields(camera))
    return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in found)


def _same(one: Bias | None, other: Bias | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.area == other.area and np.array_equal(one.values, other.values)


def _open_shutter(scene, time: float, eyes: tuple[Camera, ...]) -> tuple:
    """(key, what read_shutter says, or () while that is not known).

    Other times are read in a scene made for it, which must not be done while Blender draws: a timer does, and the
    viewport is drawn again. What the camera does at other times alone is noticed when the frame or the camera changes.
    """
    render = scene.render
    if not render.use_motion_blur:
        return (), ()
    key = time, render.motion_blur_position, render.motion_blur_shutter, *map(_values, eyes)
    known, samples = _shutters.get(scene.session_uid, ((), ()))
    if known == key:
        return key, samples
    _asked[scene.session_uid] = key
    if not bpy.app.timers.is_registered(_read_shutters):
        bpy.app.timers.register(_read_shutters)
    return key, ()


def _read_shutters() -> float | None:
    """Read the shutters asked for; while an animation plays later, for its next frame would ask again."""
    if any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows):
        return LOOK_AGAIN
    for scene in bpy.data.scenes:
        key = _asked.pop(scene.session_uid, None)
        if key is not None:
            try:
                _shutters[scene.session_uid] = key, read_shutter(scene, key[0])
            except CrowdError:  # the drawing itself says so
                _shutters[scene.session_uid] = key, ()
    _asked.clear()
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    return None


def _redraw_sidebars_soon():
    # from within a drawing Blender would forget the request
    if not bpy.app.timers.is_registered(_redraw_sidebars):
        bpy.app.timers.register(_redraw_sidebars)


def _redraw_sidebars():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


class Batches:
    """A drawing on the GPU. Needs a GPU context, as all below."""

    def __init__(self, what: Drawing):
        from gpu.types import GPUBatch, GPUVertBuf, GPUVertFormat
        from gpu_extras.batch import batch_for_shader

        self.origin, self.diameter = what.origin, what.diameter
        form = GPUVertFormat()
        columns = {"position": what.positions, "colour": what.colours, "size": what.sizes}
        for name, values in columns.items():
            form.attr_add(id=name, comp_type="F32", len=values[0].size, fetch_mode="FLOAT")
        buffer = GPUVertBuf(format=form, len=len(what.positions))
        for name, values in columns.items():
            buffer.attr_fill(name, np.ascontiguousarray(values, np.float32))
        self.points = GPUBatch(type="POINTS", buf=buffer)
        columns = {"pos": what.lines.reshape(-1, 3), "color": _encoded(what.line_colours).reshape(-1, 4)}
        self.lines = batch_for_shader(_line_shader(), "LINES", columns) if len(what.lines) else None


def _encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB from linear RGBA (..., 4) float32: Blender's own shaders take it, and undo it for the viewport."""
    encoded = linear.copy()
    rgb = linear[..., :3]
    encoded[..., :3] = np.where(rgb < 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return encoded


def paint(batches: Batches, ui_scale: float) -> None:
    """Draw into the active framebuffer with the matrices of gpu.matrix. ui_scale: pixels of this screen per nominal
    pixel of POINT_PIXELS and LINE_PIXELS."""
    import gpu
    from mathutils import Matrix

    _, _, width, height = gpu.state.viewport_get()
    projection = np.array(gpu.matrix.get_projection_matrix(), np.float64)
    view = np.array(gpu.matrix.get_model_view_matrix(), np.float64)
    view[:3, 3] += view[:3, :3] @ batches.origin
    matrix = projection @ view
    with _gpu_state():
        shader = _point_shader()
        shader.bind()
        shader.uniform_float("matrix", Matrix(matrix.tolist()))
        shader.uniform_float("pixels_per_metre", float(projection[1, 1] * height / 2))
        shader.uniform_float("diameter", batches.diameter)
        shader.uniform_float("bounds", [pixels * ui_scale for pixels in POINT_PIXELS])
        batches.points.draw(shader)
        if batches.lines is not None:
            shader = _line_shader()
            with gpu.matrix.push_pop():
                gpu.matrix.load_matrix(Matrix(view.tolist()))
                shader.bind()
                shader.uniform_float("viewportSize", (width, height))
                shader.uniform_float("lineWidth", LINE_PIXELS * ui_scale)
                batches.lines.draw(shader)


@contextmanager
def _gpu_state():
    """Depth-tested, blended, points as large as the shader says; afterwards as it was."""
    import gpu

    depth_test, depth_mask, blend = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    try:
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(True)
        gpu.state.blend_set("ALPHA")
        gpu.state.program_point_size_set(True)
        yield
    finally:
        gpu.state.program_point_size_set(False)
        gpu.state.blend_set(blend)
        gpu.state.depth_mask_set(depth_mask)
        gpu.state.depth_test_set(depth_test)


def _point_shader():
    if "points" not in _shaders:
        from gpu import shader
        from gpu.types import GPUShaderCreateInfo, GPUStageInterfaceInfo

        between = GPUStageInterfaceInfo("crowd_lod_points")
        between.flat("VEC4", "tint")
        info = GPUShaderCreateInfo()
        info.push_constant("MAT4", "matrix")
        info.push_constant("FLOAT", "pixels_per_metre")  # at a distance of 1 m; orthographic: anywhere
        info.push_constant("FLOAT", "diameter")  # metres
        info.push_constant("VEC2", "bounds")  # pixels
        info.vertex_in(0, "VEC3", "position")
        info.vertex_in(1, "VEC4", "colour")
        info.vertex_in(2, "FLOAT", "size")
        info.vertex_out(between)
        info.fragment_out(0, "VEC4", "result")
        info.vertex_source((SHADERS / "points.vert.glsl").read_text(encoding="utf-8"))
        info.fragment_source((SHADERS / "points.frag.glsl").read_text(encoding="utf-8"))
        _shaders["points"] = shader.create_from_info(info)
    return _shaders["points"]


def _line_shader():
    if "lines" not in _shaders:
        from gpu import shader

        _shaders["lines"] = shader.from_builtin("POLYLINE_FLAT_COLOR")
    return _shaders["lines"]
