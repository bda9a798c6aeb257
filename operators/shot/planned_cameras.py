"""Whether the cameras move as they did when the scene's shot was planned."""

import bpy

from ..blender.provenance import text_digest
from ..render_setup.staleness import camera_motion
from ..scene.shot_reference import reference

CAMERAS = "crowd_lod_shot_cameras"  # custom property of the scene: its plan, and their motion


def note_cameras(scene: bpy.types.Scene) -> None:
    """Note that the scene's plan is for its cameras as they move now."""
    scene[CAMERAS] = _motion(scene)


def have_cameras_changed(scene: bpy.types.Scene) -> bool:
    """Return whether the cameras move otherwise than noted, or nothing was noted of this plan."""
    return bool(scene.get(CAMERAS) != _motion(scene))


def _motion(scene: bpy.types.Scene) -> str:
    return text_digest(reference(scene.crowd_lod), camera_motion(scene))
