"""Runs through a shot and surveys it."""

from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...crowd_lod.crowd.leave_outs import LeftOut
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import numbers_of
from ...crowd_lod.progress import Workload, run_in_thread
from ...crowd_lod.shot.recording import SurveyRecording, begin_recording
from ...crowd_lod.shot.shot_cost import meshes_of
from ...crowd_lod.shot.survey import Survey
from ..blender import cameras, evaluation, scene_data
from ..scene import lights
from ..scene.characters.rig_needs import leads
from ..scene.scene_crowd import SceneCrowd, read_crowd
from ..scene.shot_reference import frame_by_policy

# What running through a frame costs: walking there, planning it, making the survey of it.
WALK, PLAN, RECORD = 4, 5, 1


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


def survey_of(crowd: SceneCrowd, frames: Sequence[int]) -> Generator[float, None, SurveyedShot]:
    """Run through the shot: yield the progress, return it.

    By tolerance, LODs may deviate by as many pixels more as their agents are blurred wide.
    CrowdError if the crowd or its choice of LODs changes on the way.
    """
    scene = crowd.scene
    policy = crowd.policy
    times = [scene_data.remap(scene.render, number) for number in frames]
    recording = _begin(crowd, frames, times)
    if policy.tolerance is not None:
        recording.tolerance = policy.tolerance
        recording.bounds = meshes_of(crowd.groups_in_meters, policy.count).bounds
    views: list[np.ndarray] = []
    before: Frame | None = None
    took = Counter()
    work = Workload((WALK + PLAN + RECORD) * len(frames))
    with evaluation.step_frames(scene) as at, recording:
        for f, time in enumerate(times):
            yield from work.take(approach(crowd.trajectory, time), WALK)
            moment = lights.read_moment(scene, time, at)
            now = read_crowd(scene)
            if now.trajectory is not crowd.trajectory or now.policy != policy:
                raise _changes_at(frames[f])
            planned = run_in_thread(partial(frame_by_policy, now, moment))
            frame = yield from work.take(planned)
            film = cameras.bound_camera(scene, time)
            cut = f > 0 and film != cameras.bound_camera(scene, times[f - 1])
            samples = scene_data.samples_of(scene) * frame.covered()
            recording.append(frame, before, samples, cut)
            views.append(numbers_of(moment.eyes))
            took.update(frame.milliseconds)
            before = frame
            yield work.did(PLAN)
    if len({numbers.shape for numbers in views}) > 1:
        raise CrowdError(
            "The number of the camera's eyes changes during the shot: plan the frames of each "
            "apart."
        )
    milliseconds = {name: total / len(frames) for name, total in took.items()}
    making = run_in_thread(recording.make_survey, lambda: 1 - len(recording.records) / len(frames))
    survey = yield from work.take(making, RECORD * len(frames))
    return SurveyedShot(survey, np.array(views), milliseconds, moment.around.left_out)


def _begin(crowd: SceneCrowd, frames: Sequence[int], times: Sequence[float]) -> SurveyRecording:
    trajectory = crowd.trajectory
    cast = crowd.cast
    lead = leads(crowd.characters, trajectory.groups)
    moved_as = cast.moved_as(trajectory.gaits, lead)
    recording = begin_recording(
        frames,
        times,
        trajectory.start.group,
        cast.first(trajectory.gaits),
        cast,
        cast.roles(trajectory.gaits, moved_as),
    )
    recording.meters = scene_data.meters(crowd.scene)
    return recording


def _changes_at(frame: int) -> CrowdError:
    return CrowdError(
        f"The crowd's settings change at frame {frame}: a shot needs one crowd and one choice of "
        f"LODs, so remove their animation and drivers, or plan the frames before and after apart."
    )
