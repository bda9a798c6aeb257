"""What has changed in a scene since its build was made.

A live build follows frame and camera by itself. What it does not follow, and all of what a bake
shows, is compared with what it was made for.
"""

from collections.abc import Mapping

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender import provenance, scene_data
from ..blender.cameras import read_cameras
from ..blender.provenance import text_digest
from ..blender.sidebar_answers import hold, keep_at_work
from ..scene.lights import read_surroundings
from ..scene.scene_crowd import SceneCrowd, read_crowd
from ..scene.shot_reference import CAMERA, content_of, plan_inputs
from .change_detection import cameras_digest, lights_digest
from .render_setup import BAKED, CAMERAS, LIGHTS

MADE_FOR = "crowd_lod_made_for"  # custom property of the build
# what live builds follow by themselves
OF_BAKES = CAMERA, "the frame range", "the resolution"
# settings that are in no digest of the crowd
SETTINGS = (
    "forward",
    "margin_kind",
    "margin",
    "shadows",
    "occlusion",
    "tilt",
)


def note_build(scene: bpy.types.Scene, made_for: Mapping[str, str]) -> None:
    """Store in the scene's build what it was made for: `inputs_of`, as the work began."""
    build = scene.crowd_lod.build
    provenance.keep(build, MADE_FOR, _of_kind(build, made_for))
    _changes.drop(scene)


@keep_at_work
def changed(scene: bpy.types.Scene) -> list[str]:
    """Return what has changed since the scene's build was made; none if it does not say.

    None without a build, too.
    """
    return _changes(scene)


def compare(scene: bpy.types.Scene) -> list[str]:
    """Return what `changed` does, after a look now."""
    _changes.drop(scene)
    return _changes(scene)


def camera_motion(scene: bpy.types.Scene) -> str:
    """Return a digest of what the scene's cameras do in all frames, and of the markers' cameras."""
    bound = [marker for marker in scene.timeline_markers if marker.camera is not None]
    bound.sort(key=lambda marker: marker.frame)
    cameras = [camera for camera in (scene.camera, *(m.camera for m in bound)) if camera]
    frames = [marker.frame for marker in bound]
    return text_digest(provenance.motion_digest(cameras), frames)


def _build_uid(scene: bpy.types.Scene) -> int:
    build = scene.crowd_lod.build
    return build.session_uid if build is not None else 0


@hold(_build_uid)
def _changes(scene: bpy.types.Scene) -> list[str]:
    build = scene.crowd_lod.build
    if build is None or not isinstance(build.get(MADE_FOR), str):
        return []
    try:
        sentences = provenance.differences(
            provenance.read_inputs(build, MADE_FOR), _of_kind(build, inputs_of(read_crowd(scene)))
        )
        if BAKED in build and not scene.frame_subframe:
            sentences += _other_in_frame(scene, build)
        return list(dict.fromkeys(sentences))
    except (CrowdError, ValueError) as error:  # a text that is not JSON is a ValueError
        return [str(error)]


def _other_in_frame(scene: bpy.types.Scene, bake: bpy.types.Collection) -> list[str]:
    """Return what of the scene's frame is other than when it was baked: the camera, the lights."""
    frame = str(scene.frame_current)
    depsgraph = scene.view_layers[0].depsgraph
    cameras = provenance.read_inputs(bake, CAMERAS)
    around = provenance.read_inputs(bake, LIGHTS)
    sentences = []
    if frame in cameras and cameras[frame] != cameras_digest(read_cameras(scene, depsgraph)):
        sentences.append(CAMERA)
    # with motion blur the shutter would have to be looked through
    if frame in around and not scene.render.use_motion_blur:
        now = read_surroundings(scene, depsgraph, scene_data.time_of(scene))
        if around[frame] != lights_digest(now):
            sentences.append("the lights")
    return sentences


def inputs_of(crowd: SceneCrowd) -> dict[str, str]:
    """Return digests of what a bake depends on, by name; a live build follows OF_BAKES."""
    scene = crowd.scene
    settings = crowd.settings
    render = scene.render
    inputs = plan_inputs(crowd)
    homes = [home and home.name for home in (settings.mirrors, settings.see_through)]
    return inputs | {
        "the settings": text_digest(homes, *(getattr(settings, name) for name in SETTINGS)),
        "the frame rate": text_digest(
            render.fps, render.fps_base, render.frame_map_old, render.frame_map_new
        ),
        "the shot plan": content_of(settings),
        CAMERA: camera_motion(scene),
        "the frame range": text_digest(scene.frame_start, scene.frame_end, scene.frame_step),
        "the resolution": text_digest(
            render.resolution_x, render.resolution_y, render.resolution_percentage
        ),
    }


def _of_kind(build: bpy.types.Collection, inputs: Mapping[str, str]) -> dict[str, str]:
    """Return those of the inputs that the build does not follow by itself."""
    own = () if BAKED in build else OF_BAKES
    return {name: digest for name, digest in inputs.items() if name not in own}
