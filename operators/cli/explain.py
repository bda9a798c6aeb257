"""The command explain: every test of one agent in one frame."""

from collections.abc import Generator

import bpy

from ...crowd_lod.frame.explanation import Explanation, explain_agent
from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.progress import share
from ..blender import frame_stepping, scene_data
from ..scene import lights
from ..scene.scene_crowd import frame_of, trajectory_of
from ..shot.shot_plan import ready
from ..sources.record_points import on_record


@on_record(lambda scene, agent, number: parse_frames(str(number)))  # says what is wrong with it
def explain(
    scene: bpy.types.Scene, agent: int, number: int
) -> Generator[float, None, tuple[Explanation, str]]:
    """Explain an agent in the frame `number` of the timeline.

    Yields the progress, returns (Explanation, why the scene's shot plan was not used, or "").
    LOD meshes that are missing are made.
    """
    yield from share(ready(scene), 0.0, 0.5)
    trajectory = trajectory_of(scene)
    time = scene_data.remap(scene.render, number)
    yield from share(approach(trajectory, time), 0.5, 0.9)
    with frame_stepping.step_frames(scene, rest=False) as at:
        eyes, around, shutter = lights.read_moment(scene, time, at)
        frame = frame_of(scene, at((), time), time, eyes, trajectory, around, shutter)
    yield 1.0
    explanation = explain_agent(frame, agent, scene_data.costs_of(scene), scene_data.meters(scene))
    return explanation, frame.unplanned
