"""Exports the crowd of a shot as USD."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.animation.phase_classes import Cast
from ....crowd_lod.crowd.wardrobe import count_people
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import byte_size, counted, printable
from ....crowd_lod.format import number as figure
from ....crowd_lod.frame.frame_range import shot_frames
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.frame.instances import (
    FrameInstances,
    Instances,
    instances_of,
    instances_of_frame,
    rotations_of,
)
from ....crowd_lod.frame.planned import note_of, unplanned_notes
from ....crowd_lod.output import files
from ....crowd_lod.progress import Workload
from ...blender import evaluation, scene_data
from ...blender.operator import Stepwise
from ...blender.output_folders import output_folder, place_of, with_ending
from ...build.frame_update import columns_of, held_by
from ...lods.costs import lacking_seconds
from ...plan.shot_plan import ready
from ...scene import lights
from ...scene.characters.character_provenance import reading
from ...scene.plan_verdict import plan_verdict
from ...scene.scene_crowd import SceneCrowd
from ...scene.shot_reference import frame_of
from ...scene.sources.record_points import on_record
from ...settings import needs
from .file import CrowdFile
from .openusd import missing_openusd, openusd
from .prototypes import cast_of_poses, names_of, write_prototypes
from .shot_camera import FilmedFrame, film_frame, write_camera

ENDINGS = (".usdc", ".usda", ".usd")
POSES = 32  # of an action's cycle, one static prototype for each
# Seconds, about: planning a frame, posing a prototype, writing the instances of a frame.
PLANNED = 0.06
POSED = 0.004
WRITTEN = 0.05


@dataclass(frozen=True)
class UsdExport:
    """What to export.

    frames: increasing, of the timeline.
    path: of the file, absolute; it ends in .usd, .usdc or .usda.
    animated: prototypes move with their phase class, instead of agents that change their pose.
    strict: a frame without the LODs of the scene's shot plan is an error.
    """

    frames: Sequence[int]
    path: Path
    animated: bool = False
    strict: bool = False


@dataclass(frozen=True)
class ExportResult:
    """What was exported: the counts, and a sentence on each thing that differs from the plan.

    agents: with what they wear, of which there are `worn` parts.
    unplanned: sentences on frames that do not follow the shot plan.
    """

    agents: int
    worn: int
    prototypes: int
    off: float
    notes: tuple[str, ...]
    unplanned: str

    @property
    def sentence(self) -> str:
        """The result in words."""
        return " ".join(
            (
                f"{count_people(self.agents, self.worn)} and "
                f"{counted(self.prototypes, 'prototype')} are written.",
                *self.notes,
            )
        )


@on_record(lambda scene, request: request.frames)
def export_usd(scene: bpy.types.Scene, request: UsdExport) -> Generator[float, None, ExportResult]:
    """Write the crowd of `scene` as USD: yield the progress, return what was written.

    LOD meshes that are missing are made. Nothing else in the scene changes. Closed early, it leaves
    no file.
    """
    usd = openusd()
    yield 0.0
    path = files.follow_link(request.path)
    if printable(path) != str(path):
        raise CrowdError(
            f"OpenUSD cannot write to {printable(path)}, which is no text in UTF-8: choose "
            f"another place."
        )
    with files.staged(path.parent, path.name) as hidden:
        count = len(request.frames)
        making = lacking_seconds(scene)
        work = Workload(making + (PLANNED + WRITTEN) * count)
        crowd = yield from work.take(ready(scene), making)
        trajectory = crowd.trajectory
        cast = cast_of_poses(crowd, POSES, request.animated)
        planning = _plan_frames(crowd, request, cast)
        plans, films, unplanned = yield from work.take(planning, PLANNED * count)
        instances = instances_of([*plans.values()])
        with CrowdFile(
            usd, scene, path, hidden, (instances, names_of(trajectory, cast, instances.prototypes))
        ) as file:
            seconds = [
                trajectory.seconds(scene_data.remap(scene.render, frame))
                for frame in request.frames
            ]
            posing = write_prototypes(
                crowd, cast, instances.prototypes, (request.frames, seconds), file.mesh
            )
            posed = POSED * len(instances.prototypes)
            work.announce(posed + WRITTEN * count)
            yield from work.take(posing, posed)
            writing = _instances(crowd, (cast, instances), plans, file)
            yield from work.take(writing, WRITTEN * count)
            if films:
                write_camera(usd, file.stage, file.CAMERA, scene, films)
            file.save((request.frames[0], request.frames[-1]))
        yield work.did(0.0)
    off = max(plan.off for plan in plans.values())
    notes = (
        [f"Agents show one of {POSES} poses, up to {figure(off)} of a cycle beside their phase."]
        if off
        else []
    )
    if len(films) < len(request.frames):
        notes.append("USD has no panoramic cameras: the file has none for them.")
    return ExportResult(
        len(instances.agents),
        int(np.count_nonzero(instances.agents >= len(trajectory.bare.start))),
        len(instances.prototypes),
        off,
        tuple(notes),
        unplanned_notes(unplanned),
    )


def _plan_frames(
    crowd: SceneCrowd, request: UsdExport, cast: Cast
) -> Generator[
    float, None, tuple[dict[int, FrameInstances], dict[int, FilmedFrame], list[tuple[int, str]]]
]:
    """Plan all frames: yield the progress, return what is shown, what films, and what is unplanned.

    The last goes to `unplanned_notes`.
    """
    scene = crowd.scene
    frames = request.frames
    plans: dict[int, FrameInstances] = {}
    films: dict[int, FilmedFrame] = {}
    unplanned = []
    work = Workload(10 * len(frames))
    with evaluation.step_frames(scene) as at:
        for number in frames:
            time = scene_data.remap(scene.render, number)
            yield from work.take(approach(crowd.trajectory, time), 9)
            moment = lights.read_moment(scene, time, at)
            yield from work.take(reading(scene))
            frame = frame_of(crowd.at_present_frame(), moment)
            unplanned.append(note_of(number, frame.unplanned, request.strict))
            plans[number] = instances_of_frame(frame, cast)
            films[number] = film_frame(scene, time, at((), time))
            yield work.did(1)
    if not any(len(plan.agents) for plan in plans.values()):
        raise CrowdError(
            f"The camera sees no agent in {shot_frames(frames)}: choose other frames, or move the "
            "camera."
        )
    return plans, {number: film for number, film in films.items() if film is not None}, unplanned


def _instances(
    crowd: SceneCrowd,
    shown: tuple[Cast, Instances],
    plans: dict[int, FrameInstances],
    file: CrowdFile,
) -> Generator[float, None, None]:
    """Write where the agents that are shown are in each frame."""
    scene = crowd.scene
    trajectory = crowd.trajectory
    cast, instances = shown
    agents = instances.agents
    turn = float(scene_data.rotation(scene.crowd_lod.forward))
    speed = scene_data.frame_rate(scene)
    work = Workload(10 * len(plans))
    for number, plan in plans.items():
        time = scene_data.remap(scene.render, number)
        yield from work.take(approach(trajectory, time), 9)
        held = held_by(crowd, number, trajectory.at(time))
        columns = columns_of(trajectory, held.crowd, held, agents, cast)
        level = np.zeros(len(agents), np.float32)
        lean = [columns.get(name, level) for name in ("pitch", "roll")]
        prototype, hidden = instances.at(plan)
        velocity = None
        for part, agents_then in held.ends:
            if part:  # the later one counts
                then = columns_of(trajectory, agents_then, held, agents, cast)["position"]
                velocity = (then - columns["position"]) * np.float32(speed / part)
        file.agents(
            number,
            positions=columns["position"],
            orientations=rotations_of(columns["heading"], *lean, turn),
            prototypes=prototype,
            hidden=hidden,
            scales=columns["size"] + 1 if "size" in columns else None,
            velocities=velocity,
            looks=columns["looks"],
        )
        yield work.did(1)


class CROWDLOD_OT_export_usd(Stepwise, bpy.types.Operator):
    bl_description = (
        "Write the crowd of the shot as USD: a point instancer, LODs in poses, materials, the "
        "camera"
    )
    bl_idname = "crowd_lod.export_usd"
    bl_label = "Export USD"
    needs = (needs.characters, needs.camera, missing_openusd)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        name = settings.usd_file
        if Path(name).name != name:
            raise CrowdError(
                f"USD File is {printable(name)}: give a name alone, such as crowd.usdc; Output "
                f"Folder says where it goes."
            )
        path = with_ending(output_folder(scene, "usd") / name, *ENDINGS)
        frames = scene_data.frames_of(scene)
        exported = yield from export_usd(
            scene, UsdExport(frames, path, settings.animated_prototypes)
        )
        verdict = plan_verdict(settings, exported.unplanned)
        size = byte_size(path.stat().st_size)
        return f"{verdict} {exported.sentence} The file of {size} is {place_of(path)}."


CLASSES = (CROWDLOD_OT_export_usd,)
