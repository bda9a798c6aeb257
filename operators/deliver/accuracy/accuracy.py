"""Error against run time of a scene: what is measured, and the page; and its button."""

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import bpy

from ....crowd_lod.behavior.walk import walks_of
from ....crowd_lod.crowd.leave_outs import LeftOut
from ....crowd_lod.culling.camera import Camera
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ....crowd_lod.frame.frame_range import shot_frames, spread_evenly
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.output import files
from ....crowd_lod.output.accuracy_page import Section, write_page
from ....crowd_lod.output.accuracy_sections import (
    behavior_section,
    culling_section,
    left_out_section,
    lod_section,
)
from ....crowd_lod.progress import Workload, run_steps_in_thread
from ....crowd_lod.validation.behavior_errors import compare_behavior, sensitivity
from ....crowd_lod.validation.culling_errors import SPAN, compare_culling, leave_outs
from ...blender import cameras, console, evaluation, scene_data
from ...blender.machine import launcher, machine_name, run_process
from ...blender.operator import Stepwise
from ...blender.output_folders import output_folder, place_of
from ...scene import lights
from ...scene.scene_crowd import SceneCrowd
from ...scene.sources.record_points import on_record
from ...settings import needs
from ..proof.verify import prepare_crowd
from .builds import make_builds
from .renders import choose_engine, lod_rows, measure_renders
from .ways import QUICK, THOROUGH, Effort, ways_of

PATIENCE = 2.0  # seconds that the command gets to end its renders
UNMOVED = "These agents follow recorded motion: there is no error of behavior to measure."
# parts of the work: making LODs, judging single frames, builds, renders
LODS, FRAMES_ALONE, BUILDS, RENDERS = 20, 20, 30, 30


def measure(
    scene: bpy.types.Scene, folder: Path, is_quick: bool = False
) -> Generator[float, None, dict[str, Any]]:
    """Measure error against run time of `scene`, and write the page; yields the progress.

    The folder gets all files or none. Other files are opened on the way: the scene is gone
    afterwards.

    is_quick: one frame, one run of each render, fewer ways, and smaller pictures.

    Returns a dict: `verdicts` by section, `tables` of rows by section, the `machine`, `files`.
    """
    effort = QUICK if is_quick else THOROUGH
    with files.staged(folder) as stage, files.temporary_folder() as scratch:
        title = Path(bpy.data.filepath).stem or scene.name
        work = Workload(LODS + FRAMES_ALONE + BUILDS + RENDERS)
        cameras.active_camera(scene)
        engine_note = choose_engine(scene)
        shot = scene_data.frames_of(scene)
        middle = shot[len(shot) // 2]
        span = range(middle, middle + SPAN)
        sections = yield from work.take(_judge_frames(scene, span, effort), LODS + FRAMES_ALONE)
        frames = [middle] if effort.frames == 1 else spread_evenly(shot, effort.frames)
        ways = ways_of(scene.crowd_lod, effort)
        base = scratch / "base.blend"
        with console.quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(base), copy=True)
        builds = yield from work.take(make_builds(base, ways, frames, effort), BUILDS)
        yield from work.take(measure_renders(builds, frames, effort.repeats), RENDERS)
        pictures = _pictures_in_words(frames, effort, engine_note)
        sections.insert(0, lod_section(lod_rows(builds, frames), pictures))
        machine = machine_name()
        names = write_page(stage, title, machine, sections)
    yield 1.0
    return {
        "machine": machine,
        "verdicts": {section.name: section.verdict for section in sections},
        "means": {section.name: section.means for section in sections},
        "tables": {section.name: section.rows for section in sections if section.rows},
        "files": names,
    }


@on_record(lambda scene, span, *_: span)
def _judge_frames(
    scene: bpy.types.Scene, span: range, effort: Effort
) -> Generator[float, None, list[Section]]:
    """Return the sections on what needs no renders; yields the progress. LODs are made if need be.

    span: frames that are culled.
    """
    work = Workload(LODS + FRAMES_ALONE)
    crowd = yield from work.take(prepare_crowd(scene), LODS)
    films = [eyes[0] for eyes in cameras.cameras_at(scene, span)]
    with evaluation.step_frames(scene) as at:
        around = lights.read_moment(scene, span[0], at).around
    for frame in span:
        yield from work.take(approach(crowd.trajectory, frame))
    judging = _sections(crowd, films, span, scene_data.frames_of(scene), around.left_out, effort)
    return (yield from work.take(run_steps_in_thread(judging), FRAMES_ALONE))


def _sections(
    crowd: SceneCrowd,
    films: Sequence[Camera],
    span: range,
    shot: Sequence[int],
    left_out: Sequence[LeftOut],
    effort: Effort,
) -> Generator[float, None, list[Section]]:
    """Return the sections; yields the progress.

    films: at the frames of the span. left_out: by the surroundings of the first of them.
    """
    trajectory, policy, runs = crowd.trajectory, crowd.policy, effort.runs
    walks = [walk for walk in walks_of(trajectory) if not walk.stays]
    behavior = Section("behavior", "Behavior", "", UNMOVED)
    if walks:
        length = min(shot[-1] - shot[0], effort.length) or 1
        moved = list(compare_behavior(walks, length, runs, effort.rates))
        behavior = behavior_section(moved, sensitivity(walks, length))
    yield 0.4
    culled = list(compare_culling(trajectory, films, policy, span[0], effort.counts, runs))
    yield 0.9
    skipped = list(leave_outs(trajectory, films[0], policy, span[0], left_out, runs))
    return [behavior, culling_section(culled), left_out_section(skipped)]


def _pictures_in_words(frames: Sequence[int], effort: Effort, engine_note: str) -> str:
    """Return what was rendered, in sentences."""
    return (
        f"Rendered: {shot_frames(frames)}, {effort.width} pixels wide and "
        f"{counted(effort.samples, 'sample')} a pixel at most, {counted(effort.repeats, 'time')}, "
        f"each in a Blender of its own. {engine_note}"
    ).strip()


class CROWDLOD_OT_report_error(Stepwise, bpy.types.Operator):
    bl_description = (
        "Compare time and memory of renders with the error of full detail, LODs by distance and by "
        "tolerance. Takes minutes; Esc stops it"
    )
    bl_idname = "crowd_lod.report_error"
    bl_label = "Report Error"
    bl_options = {"REGISTER"}
    needs = (needs.characters, needs.camera)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        folder = output_folder(scene, "error")
        stem = Path(bpy.data.filepath).stem or scene.name
        # in a process of its own: the user's scene is not touched, and its memory not measured
        with files.temporary_folder() as scratch:
            copy = scratch / f"{stem}.blend"
            with console.quiet():
                bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True)
            words = "report", "error", str(copy), "--quick", "--out", str(folder)
            command = [*launcher(), *words]
            status, last = yield from run_process(command, scratch / "log", PATIENCE)
        if status:
            raise CrowdError(last.removeprefix("crowd-lod: "))
        return f"The report is in {place_of(folder)}."


CLASSES = (CROWDLOD_OT_report_error,)
