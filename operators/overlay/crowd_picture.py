"""The picture of a frame's crowd in the index of the output folder: marks in the LODs' colors."""

from collections.abc import Generator, Iterator, Sequence

import bpy
import numpy as np

from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.progress import aside
from ...crowd_lod.reporting import files
from ...crowd_lod.reporting.crowd_picture import draw_marks, project_marks
from ...crowd_lod.reporting.output_index import CROWD
from ...crowd_lod.reporting.png_file import save_png
from ..blender import frame_stepping, scene_data
from ..blender.output_folders import output_folder
from ..blender.output_index import note_output
from ..characters.cast_provenance import reading
from ..lod_meshes.level_objects import TINTS
from ..scene import lights
from ..scene.scene_crowd import frame_of, trajectory_of

WIDTH = 480  # pixels


def note_with_picture(
    scene: bpy.types.Scene, part: str, verdict: str, frames: Sequence[int]
) -> Iterator[float]:
    """Note an output of these frames, as note_output does, with a picture of the middle one.

    Yields between steps. CrowdError if the folder cannot be written.
    """
    with files.staged(output_folder(scene, part), CROWD) as hidden:
        picture = yield from picture_frame(scene, frames[len(frames) // 2])
        save_png(hidden / CROWD, picture)
    note_output(scene, part, verdict)


def picture_frame(scene: bpy.types.Scene, number: int) -> Generator[float, None, np.ndarray]:
    """Draw the crowd in the frame `number`: yield between steps, return draw_marks' picture."""
    trajectory = trajectory_of(scene)
    time = scene_data.remap(scene.render, number)
    yield from approach(trajectory, time)
    with frame_stepping.step_frames(scene) as at:
        film, around, shutter = lights.read_moment(scene, time, at)
        yield from reading(scene)
        frame = frame_of(scene, None, time, film, trajectory, around, shutter)
        yield 0.0
    return (yield from aside(lambda: picture_agents(frame)))


def picture_agents(frame: Frame) -> np.ndarray:
    """Return the picture of the agents that the camera of the frame sees; see draw_marks."""
    spheres = frame.trajectory.spheres
    agents = np.flatnonzero(frame.visible)
    places = np.stack(frame.crowd.places(spheres.center, agents, frame.camera.origin), axis=1)
    order = np.argsort(-(places**2).sum(axis=1), kind="stable")
    radius = spheres.radius[frame.crowd.group[agents[order]]]
    middles, radii, size = project_marks(frame.camera, places[order], radius, WIDTH)
    colors = np.array(TINTS)[frame.levels[agents[order]], :3]
    return draw_marks(middles, radii, colors, size)
