"""Whether the cameras move as when the shot was planned, without a step through the shot."""

import bpy

from ..blender import provenance
from ..render_setup import staleness
from ..scene.shot_reference import reference

CAMERAS = "crowd_lod_shot_cameras"  # custom property of the scene: what moved its planned cameras


def note_cameras(scene: bpy.types.Scene) -> None:
    """Note that the scene's plan is of its cameras as they move now."""
    scene[CAMERAS] = _digest(scene)


def plans_these_cameras(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's plan was noted to be of its cameras as they move now."""
    return scene.get(CAMERAS) == _digest(scene)


def _digest(scene: bpy.types.Scene) -> str:
    return provenance.text_digest(reference(scene.crowd_lod), staleness.camera_motion(scene))
