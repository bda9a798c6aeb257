"""What a viewport shows of a scene: a frame's plan on the GPU, made anew when input changes."""

import time as clock
from dataclasses import dataclass, replace

import numpy as np

from ...crowd_lod.crowd.leave_outs import LeftOut
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.culling.occluders import Occluders
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan_of
from ...crowd_lod.frame.hidden import hide
from ...crowd_lod.frame.stages import Request
from ...crowd_lod.levels.assignment import Bias, LevelPolicy
from ...crowd_lod.shot.pixels import worst_error
from ..blender import scene_data
from ..blender.cameras import read_cameras
from ..blender.image_data import LOOK_AGAIN
from ..blender.scenery import scenery_of
from ..freshness.artifacts import CROWD, news_of, stale
from ..scene.characters.stored_groups import groups_of
from ..scene.machine.scene_world import bias_of
from ..scene.scene_crowd import SceneCrowd, policy_of, trajectory_of
from ..scene.scene_occluders import occluders_of
from ..scene.shot_overrides import digest_of
from ..scene.shot_reference import reference, use_of
from ..scene.sources.crowd_parts import GROUPS
from ..scene.sources.crowd_sources import inputs_of, live
from . import draw_data
from .appearance import bodies_of, colors_of, drawing_of, style_of
from .draw_data import Style
from .gpu_batches import Batches, GpuBodies
from .inset import Above
from .viewport_cameras import open_shutter, values_of, viewpoint


@dataclass
class Display:
    """What the viewport shows of a scene: a frame, or a problem.

    crowd_inputs: values that trajectory and bias depend on. frame_inputs: that the plan of the
        frame depends on as well. bodies_inputs: that the bodies depend on. If all are equal the
        display is up to date.
    looked: time in seconds when the trajectory was last compared with its map and state machine.
    colors: the agents' colors.
    bodies, batches: on the GPU.
    draw_began: time in seconds when its last drawing began.
    worst: pixels by which LODs in sight deviate at most; None if they are not measured.
    above: the frame from above; None until it is needed.
    notes: sentences for the user.
    problem: a sentence for the user, if nothing can be shown.
    """

    crowd_inputs: tuple = ()
    frame_inputs: tuple = ()
    bodies_inputs: tuple = ()
    looked: float = 0.0
    frame: Frame | None = None
    colors: draw_data.Colors | None = None
    bodies: GpuBodies | None = None
    batches: Batches | None = None
    draw_began: float = 0.0
    worst: float | None = None
    above: Above | None = None
    notes: tuple[str, ...] = ()
    problem: str | None = None


@dataclass(frozen=True)
class _ViewportState:
    """What the next frame of a viewport is made from, besides the crowd.

    occluders: scenery that may hide agents from the scene's camera; None hides nobody.
    refused: why other scenery may not.
    region: the viewport's region if its own view plans the crowd; None if the scene's camera does.
    eyes: the cameras that the plan is for.
    shutter: read_shutter's answer; () without motion blur, or while it is not known.
    inputs: all of it and the settings that the frame depends on, to be compared.
    """

    region: int | None
    eyes: tuple[Camera, ...]
    policy: LevelPolicy
    time: float
    shutter: tuple
    style: Style
    characters: tuple
    notes: tuple[str, ...]
    inputs: tuple
    occluders: Occluders | None = None
    refused: tuple[LeftOut, ...] = ()


def _view_of(context) -> _ViewportState:
    scene = context.scene
    settings = scene.crowd_lod
    region = context.region.as_pointer() if settings.overlay_camera == "VIEWPORT" else None
    depsgraph = context.view_layer.depsgraph
    eyes = (viewpoint(context),) if region is not None else read_cameras(scene, depsgraph)
    policy = policy_of(settings)
    time = scene_data.time_of(scene)
    key: tuple = ()
    shutter: tuple = ()
    if region is None and not live(settings):
        key, shutter = open_shutter(scene, time, eyes)
    occluders = None
    refused = ()
    if region is None and settings.occlusion:
        occluders, refused = occluders_of(scene, scenery_of(scene, depsgraph), depsgraph, (), None)
    style, characters, notes = style_of(scene, policy.count)
    if any(change.part == GROUPS for change in stale(scene, CROWD)):
        notes = (news_of(scene, CROWD),)  # LODs are made for the names that Populate gives
    inputs = (
        region,
        time,
        policy,
        *map(values_of, eyes),
        key if shutter else (),
        style,
        notes,
        settings.overlay_color,
        reference(settings),
        digest_of(settings),
        # parts that have not changed are the same occluders (blender/occluders.py)
        occluders,
    )
    return _ViewportState(
        region,
        tuple(eyes),
        policy,
        time,
        tuple(shutter),
        style,
        characters,
        notes,
        inputs,
        occluders,
        refused,
    )


def _crowd_of(
    context, policy: LevelPolicy, before: Display | None, same_frame: Frame | None, now: float
) -> tuple[SceneCrowd, float]:
    """Return the crowd, and when its trajectory and its bias were last compared with their sources.

    They are compared every LOOK_AGAIN seconds, since the pixels of maps are slow to read.
    same_frame: the frame of `before`, if nothing else has changed about the crowd.
    """
    scene = context.scene
    settings = scene.crowd_lod
    if same_frame is not None and now < before.looked + LOOK_AGAIN and not live(settings):
        return SceneCrowd(scene, same_frame.trajectory, policy, same_frame.bias), before.looked
    trajectory = trajectory_of(scene, depsgraph=context.view_layer.depsgraph)
    bias = bias_of(settings)
    if same_frame is not None and _same(bias, same_frame.bias):
        bias = same_frame.bias
    return SceneCrowd(scene, trajectory, policy, bias), now


def display_now(context, before: Display | None) -> Display:
    """Return what to show: `before` if nothing has changed."""
    now = clock.monotonic()
    try:
        crowd_inputs = _crowd_inputs(context.scene)
        view = _view_of(context)
        same_frame = (
            before.frame if before is not None and before.crowd_inputs == crowd_inputs else None
        )
        crowd, looked = _crowd_of(context, view.policy, before, same_frame, now)
        bodies_inputs = crowd.trajectory.groups, view.style.mode, view.characters
        same_bodies = before is not None and before.bodies_inputs == bodies_inputs
        same_crowd = same_frame is not None and crowd.trajectory is same_frame.trajectory
        if (
            same_crowd
            and crowd.bias is same_frame.bias
            and before.frame_inputs == view.inputs
            and same_bodies
        ):
            before.looked = looked
            return before
        frame = _plan_frame(crowd, view)
        display = Display(
            crowd_inputs=crowd_inputs,
            frame_inputs=view.inputs,
            bodies_inputs=bodies_inputs,
            looked=looked,
            frame=frame,
            notes=(*view.notes, *filter(None, [frame.unplanned])),
            worst=worst_error(frame),
        )
        _upload(display, context.scene.crowd_lod, view, before if same_bodies else None, before)
        return display
    except CrowdError as error:
        if before is not None and before.problem == str(error):
            return before
        return Display(problem=str(error))


def _plan_frame(crowd: SceneCrowd, view: _ViewportState) -> Frame:
    use = use_of(crowd, view.time, view.eyes if view.region is None else ())
    request = Request(
        time=view.time,
        eyes=view.eyes,
        policy=crowd.policy,
        shutter=view.shutter,
        bias=crowd.bias,
    )
    frame, _ = hide(plan_of(crowd.trajectory, request), view.occluders)
    return use.applied(replace(frame, left_out=(*frame.left_out, *view.refused)))


def _upload(
    display: Display,
    settings,
    view: _ViewportState,
    with_bodies: Display | None,
    before: Display | None,
) -> None:
    """Hand the display's frame to the GPU.

    with_bodies: a display with the same characters on the GPU; None if they must be uploaded.
    before: the display before, whose equal textures and batches are used again.
    """
    frame = display.frame
    groups = frame.trajectory.groups
    display.bodies = (
        with_bodies.bodies if with_bodies else bodies_of(groups, view.style, view.characters)
    )
    display.colors = colors_of(settings.overlay_color, frame, view.characters)
    # Of the viewport's own view the frustum is the viewport's edge.
    draws_frustum = view.region is None
    drawing = drawing_of(settings, frame, view.style, display.colors, draws_frustum)
    display.batches = Batches(drawing, display.bodies, before and before.batches)


def _crowd_inputs(scene) -> tuple:
    """Return the inputs of trajectory and bias, except image pixels."""
    settings = scene.crowd_lod
    bias = settings.bias_image and settings.bias_image.session_uid
    return groups_of(settings), bias, *inputs_of(scene)


def _same(first: Bias | None, second: Bias | None) -> bool:
    if first is None or second is None:
        return first is second
    return first.area == second.area and np.array_equal(first.values, second.values)
