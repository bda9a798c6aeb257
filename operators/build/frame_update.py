"""The live build: each frame's agents are written to its points."""

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Cast
from ...crowd_lod.crowd.agents import Crowd
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.culling.shutter import differs
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import cameras, evaluation, mesh_data, removal, scene_cache, scene_data
from ..blender.callbacks import clear_troubles, handler, on_main_thread
from ..blender.steps import at_work
from ..freshness.bake_frames import is_bake
from ..scene import lights
from ..scene.scene_crowd import SceneCrowd, check_levels, read_crowd
from ..scene.shot_reference import SceneMoment, frame_of
from ..scene.sources.crowd_sources import is_live, live
from ..settings.crowds import crowds_of
from .appended_builds import standing_still
from .render_setup import LOD_SIZES, cast_of, lod_sizes
from .shelves import buckets_of, members, points_in, points_of


@dataclass(frozen=True)
class OpenShutter:
    """What a frame keeps while its shutter is open: each agent's character.

    crowd: the crowd at the frame.
    time: the frame's time, in frames of the animation.
    ends: () without motion blur; else for the opening and the closing of the shutter (frames of the
        timeline from that frame, the crowd then).
    """

    crowd: Crowd
    time: float
    ends: tuple[tuple[float, Crowd], ...] = ()


def held_by(crowd: SceneCrowd, number: float, agents: Crowd) -> OpenShutter:
    """Return what the frame `number` of the timeline holds; agents: at that frame."""
    render = crowd.scene.render
    length = render.motion_blur_shutter
    time = scene_data.remap(render, number)
    if not render.use_motion_blur or not length:
        return OpenShutter(agents, time)
    opens = cameras.OPENS[render.motion_blur_position] * length
    parts = -opens, length - opens
    ends = [
        (part, crowd.trajectory.at(scene_data.remap(render, number + part)) if part else agents)
        for part in parts
    ]
    return OpenShutter(agents, time, tuple(ends))


def columns_of(
    trajectory: Trajectory, crowd: Crowd, held: OpenShutter, agents: np.ndarray, cast: Cast
) -> dict[str, np.ndarray]:
    """Return the point attributes of `agents` (m,) as they stand in `crowd`, by name.

    See `columns_by_bucket`.
    """
    return columns_by_bucket(trajectory, crowd, held, [agents], cast)[0]


def columns_by_bucket(
    trajectory: Trajectory,
    crowd: Crowd,
    held: OpenShutter,
    buckets: Sequence[np.ndarray],
    cast: Cast,
) -> list[dict[str, np.ndarray]]:
    """Return the point attributes of each bucket's agents (m,), by name.

    The agents stand as in `crowd`. For mesh_data.write_points.

    position: meters, world space.
    heading, of agents on slopes also pitch and roll (see height_map.lean): radians.
    phase, group: those of the agent.
    pose: which of the `cast`'s characters the agent shows, of the frame of `held`.
    size: of agents of other sizes, how much more than 1 their scale is.
    looks: a number in [0, 1) per agent, by which materials may vary.
    id: the stable index of the agent; of what is worn, its wearer's.
    row: where agents wear something, the index in the crowd, which holds what they wear too.

    An agent that comes back on the other side of the map between the frame of `held` and
    `crowd` stays where it was: the blur would draw it across the whole picture.
    """
    # all are looked up together: few lookups, and not of few
    ids = np.concatenate(buckets).astype(np.int32, copy=False)
    agents = ids.astype(np.intp)

    def of(column: np.ndarray) -> np.ndarray:
        return column.take(agents, mode="clip")  # several times as fast as column[agents]

    positions = np.empty((len(agents), 3), np.float32)
    stays = trajectory.jumped(crowd, held.crowd, agents)
    for axis, name in enumerate("xyz"):
        values = of(getattr(crowd, name))
        if stays is not None:
            values = np.where(stays, of(getattr(held.crowd, name)), values)
        positions[:, axis] = values
    seconds = trajectory.seconds(held.time)
    columns = {
        "position": positions,
        "heading": of(crowd.heading),
        "phase": trajectory.gaits.phase(held.crowd, seconds, agents),
        "group": of(crowd.group).astype(np.int32),
        "looks": of(trajectory.looks),
        "id": ids,
    }
    if trajectory.wearer is not None:
        columns |= {"id": of(trajectory.wearer).astype(np.int32), "row": ids}
    columns["pose"] = cast.character_of(trajectory.gaits, held.crowd, seconds, agents)
    scale = trajectory.scale(held.crowd, agents)
    if scale is not None:
        columns["size"] = scale - 1
    leaning = trajectory.tilt(crowd, agents)
    if leaning is not None:
        columns |= dict(zip(("pitch", "roll"), leaning, strict=True))
    ends = np.cumsum([len(bucket) for bucket in buckets])
    return [
        {name: values[end - len(bucket) : end] for name, values in columns.items()}
        for bucket, end in zip(buckets, ends, strict=True)
    ]


def indices_in(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the indices (m,) int32 in the crowd of the agents in `columns`."""
    return columns.get("row", columns["id"])


def write(
    top: bpy.types.Collection,
    trajectory: Trajectory,
    frame: Frame,
    held: OpenShutter,
    crowd: Crowd,
) -> None:
    """Write the agents of the frame's buckets to the points of the build `top`.

    The agents stand as in `crowd`. Buckets without a point object are skipped: a user may
    have removed those of the unseen agents.
    """
    points = points_of(top)
    written_agents = {
        bucket: agents
        for bucket, agents in members(frame).items()
        if bucket in points and (len(agents) or not _empty(points[bucket].data))
    }
    cast = cast_of(top, trajectory)
    if not written_agents:
        return
    columns_of_buckets = columns_by_bucket(
        trajectory, crowd, held, list(written_agents.values()), cast
    )
    for bucket, columns in zip(written_agents, columns_of_buckets, strict=True):
        mesh_data.write_points(points[bucket].data, columns)


def _empty(mesh: bpy.types.Mesh) -> bool:
    """Return whether the mesh was written without points: it has the attributes only."""
    return not len(mesh.vertices) and "id" in mesh.attributes


def empty(top: bpy.types.Collection) -> None:
    """Remove all points from the build `top`, even if our data in it is spoilt."""
    for points in points_in(top):
        points.data.clear_geometry()
        points.data.update_tag()


@dataclass(frozen=True)
class Planned:
    """The plan of a frame, and what goes with it.

    held: what the frame keeps while its shutter is open.
    shutter: the cameras at times of the open shutter, of cameras.read_shutter; () if nothing blurs.
    """

    trajectory: Trajectory
    frame: Frame
    held: OpenShutter
    shutter: Sequence[tuple[float, Sequence[Camera]]]


@dataclass(frozen=True)
class Rendering:
    """The frame that a scene renders now.

    number: its time on the timeline.
    planned: by scene and view layer, the plan that the first time of its open shutter made; it
        holds for all times of the shutter.
    """

    number: float
    planned: dict[tuple[int, str], Planned] = field(default_factory=dict)


_rendering: dict[int, Rendering] = {}  # by the scene's session_uid
# the session_uids of the scenes of whose camera this render has said that it was not foreseen
_told: set[int] = set()
# of each scene, why the frame shown last does not use the shot plan
_unplanned: dict[int, str] = scene_cache.add_cache({}, by_scene=True)
# The evaluation.stage of a render in a file of several scenes, to be removed when it ends: Blender
# crashes where anything is removed while it renders scenes that compositing nodes show.
_stages: list[bpy.types.Scene] = []


@handler
def rendering(scene: bpy.types.Scene, *_) -> None:
    """Note the frame that a render begins (render_pre handler).

    CrowdError, for the guard to tell, if the scene has a build that nothing moves.
    """
    _rendering[scene.session_uid] = Rendering(scene.frame_current + scene.frame_subframe)
    if told := standing_still(scene):
        raise CrowdError(told)


@handler
def rendered(scene: bpy.types.Scene, *_) -> None:
    """Forget the frame that was rendered (render_post and render_cancel handler)."""
    _rendering.pop(scene.session_uid, None)


@handler
def ended(*_) -> None:
    """Tidy up after a whole render (render_complete and render_cancel handler)."""
    _told.clear()
    if _stages:
        with suppress(CrowdError):
            on_main_thread(partial(removal.remove, _stages[:]))
        _stages.clear()


@handler
def forget(*_) -> None:
    """Forget renders and their stages when another file is loaded (load_pre handler)."""
    _rendering.clear()
    _stages.clear()
    _told.clear()


def shutter_frame(scene: bpy.types.Scene, now: Rendering | None) -> float:
    """Return the timeline frame in whose shutter the current time falls.

    Without motion blur it is the time itself. While Blender renders it is the rendered frame:
    shutters of a frame and longer overlap, so time alone does not decide.
    """
    time = scene.frame_current + scene.frame_subframe
    if not scene.render.use_motion_blur:
        return time
    if now is not None and abs(time - now.number) <= scene.render.motion_blur_shutter:
        return now.number
    return float(np.floor(time + opening(scene.render)))


def opening(render: bpy.types.RenderSettings) -> float:
    """Return the part of a frame by which the shutter opens before the frame.

    Blender's engines ask for times rounded to float32; a margin of 1e-4 keeps a frame's own time in
    that frame.
    """
    opens = cameras.OPENS[render.motion_blur_position] if render.use_motion_blur else 0.0
    return opens + (-1e-4 if opens == 1.0 else 1e-4)


def update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Frame | None:
    """Show the scene's current time in its build, unless it is baked; return the plan of it.

    A pure function of frame and sub-frame.

    With motion blur every time within a frame's shutter shows that frame's buckets and poses, at
    the positions of its own time. An agent that changed its object, or its instance, while the
    shutter is open would lose its blur.
    """
    top = scene.crowd_lod.build
    if is_bake(top):
        return None
    render_now = _rendering.get(scene.session_uid)
    # another scene's compositing nodes show this one, at the same frame
    if render_now is None and depsgraph.mode == "RENDER":
        render_now = next(iter(_rendering.values()), None)
    number = shutter_frame(scene, render_now)
    time = scene_data.time_of(scene)
    layer_key = (scene.session_uid, depsgraph.view_layer_eval.name)
    # a viewport shows no blur
    blurred = scene.render.use_motion_blur and depsgraph.mode == "RENDER"
    plans = (
        render_now.planned
        if blurred and render_now is not None and render_now.number == number
        else {}
    )
    if layer_key not in plans:
        plans[layer_key] = _planned(scene, depsgraph, number, time, blurred)
    planned = plans[layer_key]
    _compare(scene, depsgraph, number, time, planned)
    frame = planned.frame
    crowd = frame.crowd if frame.time == time else planned.trajectory.at(time)
    write(top, planned.trajectory, frame, planned.held, crowd)
    clear_troubles(scene)
    return frame


def _planned(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    number: float,
    time: float,
    blurred: bool,
) -> Planned:
    """Return the plan of the timeline frame `number`.

    depsgraph: at `time`.
    blurred: plan all that the shutter sees.
    """
    crowd = read_crowd(scene, depsgraph)
    check_levels(crowd)
    _check_build(crowd)
    whole = scene_data.remap(scene.render, number)
    with evaluation.stage(_stages if _rendering and len(bpy.data.scenes) > 1 else None) as at:
        # a marker's camera becomes the active one only after the handlers of its frame
        if whole == time:
            film = cameras.cameras_from(scene, cameras.bound_camera(scene, whole), depsgraph)
            times = []
        else:
            film = cameras.camera_at(scene, whole, at)
            times = [whole]
        shutter = cameras.read_shutter(scene, whole, at) if blurred else []
        around = lights.read_surroundings(
            scene, depsgraph, whole, [part for part, _ in shutter] or times, at
        )
    frame = frame_of(crowd, SceneMoment(whole, film, around, shutter))
    if frame.unplanned and _unplanned.get(scene.session_uid) != frame.unplanned:
        print(f"Crowd LOD, frame {number:g}: {frame.unplanned}", file=sys.stderr)
    _unplanned[scene.session_uid] = frame.unplanned
    held = held_by(crowd, number, frame.crowd)
    return Planned(crowd.trajectory, frame, held, shutter)


def _check_build(crowd: SceneCrowd) -> None:
    """Raise CrowdError if the build cannot show the LODs that the scene has now."""
    scene = crowd.scene
    top = crowd.settings.build
    needed = {bucket for bucket in buckets_of(crowd.policy.count) if bucket.is_seen}
    if needed - points_of(top).keys():
        raise CrowdError(
            f"The build of {scene.name} lacks LODs that its settings ask for: press Build again."
        )
    sizes = lod_sizes(scene)
    if top.get(LOD_SIZES, sizes) != sizes:
        raise CrowdError(
            f"The LOD meshes of {scene.name} have changed since its build was made: press Build "
            f"again."
        )


def _compare(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    number: float,
    time: float,
    planned: Planned,
) -> None:
    """Warn once per render if cameras at `time` differ from those that were planned with.

    A render cannot step its scene, and drivers, physics or other add-ons may move the camera only
    when it is stepped.
    """
    planned_eyes = next((eyes for when, eyes in planned.shutter if abs(when - time) < 1e-4), ())
    if not planned_eyes or scene.session_uid in _told:
        return
    camera = cameras.bound_camera(scene, scene_data.remap(scene.render, number))
    if any(map(differs, planned_eyes, cameras.cameras_from(scene, camera, depsgraph))):
        _told.add(scene.session_uid)
        print(
            f"Crowd LOD, frame {number:g}: while the shutter is open, the camera {camera.name} "
            f"moves as only playback of the scene "
            "shows (drivers, physics, other add-ons), so agents at the picture's edges may be "
            "missing: bake, and render the bake.",
            file=sys.stderr,
        )


@handler
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Update the build to the frame and the camera (frame_change_post handler).

    The camera is the one that `depsgraph` has evaluated.
    """
    if scene.crowd_lod.build is None or evaluation.is_stepped(scene):
        return
    if scene.library is not None:  # points of a linked file do not reach renders
        return
    on_main_thread(lambda: _show(scene, depsgraph))


def _show(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    try:
        update(scene, depsgraph)
    except Exception:
        empty(scene.crowd_lod.build)  # the crowd of another frame would be a wrong picture
        raise


@handler
def follow_points(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Update the build to an edited object whose points are agents (depsgraph_update_post handler).

    Our own points are updated, too, but are no crowd's source: that would call this again and
    again.
    """
    settings = scene.crowd_lod
    if settings.build is None or at_work() or not live(settings):
        return
    sources = {crowd.points for crowd in crowds_of(settings) if is_live(crowd)}
    if any(
        (each.is_updated_geometry or each.is_updated_transform) and each.id.original in sources
        for each in depsgraph.updates
    ):
        follow(scene, depsgraph)
