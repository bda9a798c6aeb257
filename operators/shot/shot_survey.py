"""Runs through a shot and surveys it. Where a run was killed, the next one goes on."""

import hashlib
import os
import time as clock
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.animation.phase_classes import Library
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.leave_outs import LeftOut
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import numbers_of
from ...crowd_lod.frame.shadows import surrounded
from ...crowd_lod.levels.assignment import LevelPolicy
from ...crowd_lod.progress import aside, share, standing
from ...crowd_lod.shot.recording import Record, Recorder, Recording, begin_recording
from ...crowd_lod.shot.shot_cost import meshes_of
from ...crowd_lod.shot.survey import Encounters, Survey
from ..blender import cameras, frame_stepping, scene_data
from ..characters.rig_needs import leads
from ..lod_meshes.selection import cast_of
from ..machine.scene_world import bias_of
from ..render_setup.cost_estimate import covered
from ..scene import lights, shot_reference
from ..scene.scene_crowd import characters_of, policy_of, trajectory_of

EVERY = 20.0  # seconds between two saves, from which the next run goes on
KEPT = "rays", "cut", "hidden"  # of a Record, numbers
# arrays of a Record, and of its encounters
ARRAYS = "present", "kind", "coarsest", "scale", "character", "entered", "left"
PAIRS = tuple(column.name for column in fields(Encounters))
PARTS = ".crowd-lod-survey"  # begins the names of the parts' files


@dataclass
class SurveyedShot:
    """A shot that was run through.

    cameras: (F, E, 21) float64, of frame.planned.numbers_of.
    milliseconds: of each stage, the mean of the frames that this run planned.
    left_out: what the surroundings of the last frame do not need, and why.
    """

    survey: Survey
    cameras: np.ndarray
    milliseconds: dict[str, float] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()


def survey_of(
    scene: bpy.types.Scene, frames: Sequence[int], folder: Path | None = None, blurred: bool = False
) -> Generator[float, None, SurveyedShot]:
    """Run through the shot: yield the progress, return it.

    blurred: let LODs be as many pixels coarser as their agents are blurred wide.
    folder: keeps what is surveyed so far, for a run that is killed; None keeps nothing.
    CrowdError if the crowd or its choice of LODs changes on the way.
    """
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    policy = policy_of(settings)
    library = cast_of(characters_of(scene), trajectory)
    times = [scene_data.remap(scene.render, number) for number in frames]
    recording = _begin(scene, frames, times, library)
    if blurred:
        _coarsen_where_blurred(recording, measured_groups(scene), policy)
    parts = Parts(recording, folder, _key(scene, frames) + "b" * blurred)
    begin = parts.taken_up()
    before = None
    took = Counter()
    saved = clock.monotonic()
    with frame_stepping.step_frames(scene) as at, Recorder(recording) as recorder:
        for f in range(max(begin - 1, 0), len(frames)):
            time = times[f]
            yield from share(approach(trajectory, time), f / len(frames), (f + 0.5) / len(frames))
            eyes, around, shutter = lights.read_moment(scene, time, at)
            if trajectory_of(scene) is not trajectory or policy_of(settings) != policy:
                raise _changes_at(frames[f])
            bias = bias_of(settings)
            planning = partial(plan, trajectory, eyes, policy, time, shutter, bias)
            planned = aside(partial(surrounded, planning, around))
            frame = yield from standing(planned, (f + 0.5) / len(frames))
            if f >= begin:
                film = cameras.bound_camera(scene, time)
                cut = f > 0 and film != cameras.bound_camera(scene, times[f - 1])
                samples = scene_data.samples_of(scene) * covered(frame)
                recorder.add(frame, before, samples, cut)
                parts.cameras.append(numbers_of(eyes))
                took.update(frame.milliseconds)
            before: Frame | None = frame
            if clock.monotonic() > saved + EVERY:
                recorder.finish()
                parts.keep(f + 1)
                saved = clock.monotonic()
            yield (f + 1) / len(frames)
        recorder.finish()
    if len({each.shape for each in parts.cameras}) > 1:
        raise CrowdError(
            "The number of the camera's eyes changes during the shot: plan the frames of each "
            "apart."
        )
    count = max(len(frames) - begin, 1)
    milliseconds = {name: total / count for name, total in took.items()}
    survey = yield from standing(aside(recording.make_survey), 1.0)
    return SurveyedShot(survey, np.array(parts.cameras), milliseconds, around.left_out)


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


def _coarsen_where_blurred(
    recording: Recording, groups: Sequence[Group], policy: LevelPolicy
) -> None:
    """Let the recording have LODs that are coarser where their agents are blurred.

    CrowdError if LODs are not chosen by tolerance.
    """
    if policy.tolerance is None:
        raise CrowdError(
            "Coarser Where Blurred needs LODs by tolerance: set Choose LODs to By Tolerance, "
            "or switch it off."
        )
    recording.bounds = meshes_of(groups, policy.count).bounds
    recording.blurred = policy.tolerance


def _key(scene: bpy.types.Scene, frames: Sequence[int]) -> str:
    """Return a text that tells surveys apart: of the file, the crowd, the frames."""
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    file = Path(bpy.data.filepath)
    data = file.read_bytes() if bpy.data.filepath and file.is_file() else b""
    about = shot_reference.plan_inputs(settings, trajectory, policy_of(settings), bias_of(settings))
    kept = __version__, scene.name, list(frames), about, scene.render.engine
    text = repr((*kept, scene_data.meters(scene)))
    return hashlib.sha256(text.encode() + data).hexdigest()[:16]


class Parts:
    """Parts of a survey that are kept in a folder until the whole is done.

    cameras: those of the frames so far.
    """

    def __init__(self, recording: Recording, folder: Path | None, key: str):
        self.recording = recording
        self.folder = folder
        self.key = key
        self.done = 0
        self.cameras: list[np.ndarray] = []

    def taken_up(self) -> int:
        """Read the parts that a killed run left; return the number of frames that they hold."""
        while self.folder is not None and (
            found := sorted(self.folder.glob(f"{PARTS}-{self.key}-{self.done}-*.npz"))
        ):
            with np.load(found[-1], allow_pickle=False) as file:
                end = self.done + len(file["cameras"])
                self.cameras.extend(file["cameras"])
                self.recording.records += _read_records(file)
            self.done = end
        return self.done

    def keep(self, end: int) -> None:
        """Keep the frames up to `end`, exclusive, in a file of their own."""
        if self.folder is None or end <= self.done:
            return
        rows = slice(self.done, end)
        path = self.folder / f"{PARTS}-{self.key}-{self.done}-{end}.npz"
        with suppress(OSError):  # the run itself needs none of it
            self.folder.mkdir(parents=True, exist_ok=True)
            with path.with_suffix(".part").open("wb") as file:
                columns = _columns_of(self.recording.records[rows])
                np.savez(file, cameras=self.cameras[rows], **columns)
                file.flush()
                os.fsync(file.fileno())
            path.with_suffix(".part").replace(path)
            self.done = end


def _columns_of(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Return the arrays of a part's file. Those of all frames follow one another."""
    columns = {name: np.array([getattr(record, name) for record in records]) for name in KEPT}
    for name in (*ARRAYS, *PAIRS):
        arrays = [
            getattr(record if name in ARRAYS else record.encounters, name) for record in records
        ]
        columns[name] = np.concatenate(arrays)
        columns[f"{name}_counts"] = np.array([len(array) for array in arrays])
    return columns


def _read_records(file: Mapping[str, np.ndarray]) -> list[Record]:
    """Return the records of a part's file."""
    arrays = {
        name: np.split(file[name], np.cumsum(file[f"{name}_counts"])[:-1])
        for name in (*ARRAYS, *PAIRS)
    }
    numbers = {name: file[name].tolist() for name in KEPT}
    return [
        Record(
            **{name: arrays[name][f] for name in ARRAYS},
            **{name: numbers[name][f] for name in KEPT},
            encounters=Encounters(*(arrays[name][f] for name in PAIRS)),
        )
        for f in range(len(file["cameras"]))
    ]


def forget_parts(folder: Path) -> None:
    """Remove all parts of surveys in `folder`."""
    for path in folder.glob(f"{PARTS}-*"):
        path.unlink(missing_ok=True)
