"""The frame of a scene, planned as renders plan it."""

from crowd_lod_extension.operators.blender.cameras import read_cameras
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.scene.shot_reference import SceneMoment, frame_of, moment_now


def frame_now(scene, depsgraph, around=None):
    """The plan of the scene's present frame, with the lights and mirrors `around`."""
    return frame_of(read_crowd(scene, depsgraph), moment_now(scene, depsgraph, around))


def frame_at(scene, depsgraph, time):
    """The plan of the crowd at another time, filmed by the cameras as `depsgraph` has them."""
    moment = SceneMoment(time, read_cameras(scene, depsgraph))
    return frame_of(read_crowd(scene, depsgraph), moment)
