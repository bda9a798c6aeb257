"""Runs through a shot and surveys it."""

from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Library
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.leave_outs import LeftOut
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import numbers_of
from ...crowd_lod.frame.shadows import surrounded
from ...crowd_lod.progress import aside, share, standing
from ...crowd_lod.shot.recording import Recorder, Recording, begin_recording
from ...crowd_lod.shot.shot_cost import meshes_of
from ...crowd_lod.shot.survey import Survey
from ..blender import cameras, frame_stepping, scene_data
from ..characters.rig_needs import leads
from ..lod_meshes.selection import cast_of
from ..machine.scene_world import bias_of
from ..render_setup.cost_estimate import covered
from ..scene import lights
from ..scene.scene_crowd import characters_of, policy_of, trajectory_of

THROUGH = 0.9  # the progress with which the shot is run through: the rest makes the survey


@dataclass
class SurveyedShot:
    """A shot that was run through.

    cameras: (F, E, 21) float64, of frame.planned.numbers_of.
    milliseconds: of each stage, the mean of the frames.
    left_out: what the surroundings of the last frame do not need, and why.
    """

    survey: Survey
    cameras: np.ndarray
    milliseconds: dict[str, float] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()


def survey_of(
    scene: bpy.types.Scene, frames: Sequence[int]
) -> Generator[float, None, SurveyedShot]:
    """Run through the shot: yield the progress, return it.

    By tolerance, LODs may deviate by as many pixels more as their agents are blurred wide.
    CrowdError if the crowd or its choice of LODs changes on the way.
    """
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    policy = policy_of(settings)
    library = cast_of(characters_of(scene), trajectory)
    times = [scene_data.remap(scene.render, number) for number in frames]
    recording = _begin(scene, frames, times, library)
    if policy.tolerance is not None:
        recording.tolerance = policy.tolerance
        recording.bounds = meshes_of(measured_groups(scene), policy.count).bounds
    views: list[np.ndarray] = []
    before: Frame | None = None
    took = Counter()
    with frame_stepping.step_frames(scene) as at, Recorder(recording) as recorder:
        for f, time in enumerate(times):
            begin, middle, end = (THROUGH * (f + part) / len(frames) for part in (0.0, 0.5, 1.0))
            yield from share(approach(trajectory, time), begin, middle)
            eyes, around, shutter = lights.read_moment(scene, time, at)
            if trajectory_of(scene) is not trajectory or policy_of(settings) != policy:
                raise _changes_at(frames[f])
            bias = bias_of(settings)
            planning = partial(plan, trajectory, eyes, policy, time, shutter, bias)
            planned = aside(partial(surrounded, planning, around))
            frame = yield from standing(planned, middle)
            film = cameras.bound_camera(scene, time)
            cut = f > 0 and film != cameras.bound_camera(scene, times[f - 1])
            samples = scene_data.samples_of(scene) * covered(frame)
            recorder.add(frame, before, samples, cut)
            views.append(numbers_of(eyes))
            took.update(frame.milliseconds)
            before = frame
            yield end
        recorder.finish()
    if len({numbers.shape for numbers in views}) > 1:
        raise CrowdError(
            "The number of the camera's eyes changes during the shot: plan the frames of each "
            "apart."
        )
    milliseconds = {name: total / len(frames) for name, total in took.items()}
    making = aside(recording.make_survey, lambda: 1 - len(recording.records) / len(frames))
    survey = yield from share(making, THROUGH, 1.0)
    return SurveyedShot(survey, np.array(views), milliseconds, around.left_out)


def _begin(
    scene: bpy.types.Scene, frames: Sequence[int], times: Sequence[float], library: Library
) -> Recording:
    trajectory = trajectory_of(scene)
    lead = leads(characters_of(scene), trajectory.groups)
    moved_as = library.moved_as(trajectory.gaits, lead)
    recording = begin_recording(
        frames,
        times,
        trajectory.start.group,
        library.first(trajectory.gaits),
        library,
        library.roles(trajectory.gaits, moved_as),
    )
    recording.meters = scene_data.meters(scene)
    return recording


def _changes_at(frame: int) -> CrowdError:
    return CrowdError(
        f"The crowd's settings change at frame {frame}: a shot needs one crowd and one choice of "
        f"LODs, so remove their animation and drivers, or plan the frames before and after apart."
    )


def measured_groups(scene: bpy.types.Scene) -> list[Group]:
    """Return the groups of the scene's crowd with their lengths in meters, as of its surveys."""
    return [group.scaled(scene_data.meters(scene)) for group in trajectory_of(scene).groups]
