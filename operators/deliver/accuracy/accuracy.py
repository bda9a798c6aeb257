"""Error against run time of a scene: what is measured, and the page; and its button."""

import contextlib
import re
import signal
import subprocess
import sys
import threading
import time as clock
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ....crowd_lod.behavior.walk import Walk, walks_of
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
from ....crowd_lod.progress import LOOK, Workload, run_in_thread
from ....crowd_lod.validation import behavior_errors, culling_errors, timing
from ....crowd_lod.validation.behavior_errors import RATES
from ...blender import cameras, console, scene_data
from ...blender.machine import keeping_files_in, launcher, machine_name
from ...blender.operator import Stepwise
from ...blender.output_folders import output_folder, place_of
from ...scene.sources.record_points import on_record
from ...settings import needs
from ..proof.verify import prepare_crowd
from .builds import Wanted, make_builds
from .lod_rows import lod_rows
from .renders import choose_engine, measure_renders
from .ways import ways_of

PATIENCE = 2.0  # seconds that a command gets to end
PROGRESS = re.compile(r"(\d+)%")  # in what a command prints
UNMOVED = "These agents follow recorded motion: there is no error of behavior to measure."
# parts of the work: what needs no renders (making LODs, behavior, culling), builds, renders
FRAMES_ALONE, BUILDS, RENDERS = 40, 30, 30
LODS, BEHAVIOR, CULLING = 20, 10, 10


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    frames, repeats: that are rendered, and how often. width, samples: of their pictures, at most.
    length: frames that behavior is followed for. rates: steps a second of its ways.
    counts: agents that are culled.
    runs: of each way of behavior and culling, at least.
    """

    frames: int
    repeats: int
    width: int
    samples: int
    length: int
    rates: tuple[int, ...]
    counts: tuple[int, ...]
    runs: int


THOROUGH = Effort(3, 3, 960, 16, 120, RATES, (1000, 10_000, 100_000, 1_000_000), timing.FEWEST)
QUICK = Effort(1, 1, 480, 4, 48, RATES[:2], (1000, 10_000, 100_000), 2)


@dataclass(frozen=True)
class Accuracy:
    """What to measure.

    is_quick: one frame, one run of each render, fewer ways, and smaller pictures.
    """

    folder: Path
    is_quick: bool = False


def measure(scene: bpy.types.Scene, task: Accuracy) -> Generator[float, None, dict[str, Any]]:
    """Measure error against run time of `scene`, and write the page; yields the progress.

    The folder gets all files or none. Other files are opened on the way: the scene is gone
    afterwards.

    Returns a dict: `verdicts` by section, `tables` of rows by section, the `machine`, `files`.
    """
    with files.staged(task.folder) as stage, files.temporary_folder() as scratch:
        title = Path(bpy.data.filepath).stem or scene.name
        effort = QUICK if task.is_quick else THOROUGH
        work = Workload(FRAMES_ALONE + BUILDS + RENDERS)
        cameras.active_camera(scene)
        engine_note = choose_engine(scene)
        shot = scene_data.frames_of(scene)
        middle = shot[len(shot) // 2]
        span = range(middle, middle + culling_errors.SPAN)
        length = min(shot[-1] - shot[0], effort.length) or 1
        sections = yield from work.take(_judge_frames(scene, span, length, effort), FRAMES_ALONE)
        frames = [middle] if effort.frames == 1 else spread_evenly(shot, effort.frames)
        ways = ways_of(scene.crowd_lod, task.is_quick)
        wanted = Wanted(ways, frames, effort.width, effort.samples)
        base = scratch / "base.blend"
        with console.quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(base), copy=True)
        builds = yield from work.take(make_builds(base, scratch, wanted), BUILDS)
        taken = yield from work.take(measure_renders(builds, frames, effort.repeats), RENDERS)
        pictures = _pictures_in_words(wanted, effort.repeats, engine_note)
        sections.insert(0, lod_section(lod_rows(builds, taken), pictures))
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
    scene: bpy.types.Scene, span: range, length: int, effort: Effort
) -> Generator[float, None, list[Section]]:
    """Return the sections on what needs no renders; yields the progress. LODs are made if need be.

    span: frames that are culled.
    length: frames that behavior is followed for.
    """
    work = Workload(LODS + BEHAVIOR + CULLING)
    crowd = yield from work.take(prepare_crowd(scene), LODS)
    trajectory = crowd.trajectory
    sections = [Section("behavior", "Behavior", "", UNMOVED)]
    for walk in walks_of(trajectory)[:1]:
        if not (walk.seated or walk.still):
            judging = run_in_thread(partial(_judge_behavior, walk, length, effort))
            sections = [(yield from work.take(judging, BEHAVIOR))]
    films = [eyes[0] for eyes in cameras.cameras_at(scene, span)]
    for frame in span:
        yield from work.take(approach(trajectory, frame))
    comparing = culling_errors.compare_culling(
        trajectory, films, crowd.policy, span[0], effort.counts, effort.runs
    )
    rows = yield from work.take(run_in_thread(lambda: list(comparing)), CULLING)
    left_out = culling_errors.leave_outs(trajectory, films[0], crowd.policy, span[0], effort.runs)
    saved = yield from work.take(run_in_thread(lambda: list(left_out)))
    return [*sections, culling_section(rows), left_out_section(saved)]


def _judge_behavior(walk: Walk, length: int, effort: Effort) -> Section:
    rows = list(behavior_errors.compare_behavior(walk, length, effort.runs, effort.rates))
    return behavior_section(rows, behavior_errors.sensitivity(walk, length))


def _pictures_in_words(wanted: Wanted, repeats: int, engine_note: str) -> str:
    """Return what was rendered, in sentences."""
    sentences = [
        f"Rendered: {shot_frames(wanted.frames)}, {wanted.width} pixels wide and "
        f"{counted(wanted.samples, 'sample')} a pixel at most, {counted(repeats, 'time')}, each in "
        f"a Blender of its own.",
        engine_note,
    ]
    return " ".join(filter(None, sentences))


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
        with files.temporary_folder() as scratch:
            copy = scratch / f"{stem}.blend"
            with console.quiet():
                bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True)
            words = ["report", "error", str(copy), "--quick", "--out", str(folder)]
            yield from _run_command(words, scratch)
        return f"The report is in {place_of(folder)}."


def _run_command(words: Sequence[str], scratch: Path) -> Generator[float, None, None]:
    """Run a command in a process of its own, which ends with the steps; yields its progress.

    The user's scene is not touched, and its memory is not measured. CrowdError says what the
    command says.

    scratch: for its temporary files.
    """
    process = subprocess.Popen(
        [*launcher(), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=keeping_files_in(scratch),
    )
    told = ["the process was ended"]
    progress = 0.0

    def listen() -> None:
        nonlocal progress
        for line in process.stderr:
            told.append(line.decode(errors="replace").strip())
            if found := PROGRESS.search(told[-1]):
                progress = int(found[1]) / 100

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        while process.poll() is None:
            clock.sleep(LOOK)
            yield progress
    finally:
        _end(process)
        listener.join()
    if process.returncode:
        raise CrowdError(told[-1].removeprefix("crowd-lod: "))


def _end(process: subprocess.Popen) -> None:
    """End a command, as Ctrl-C does: it ends the renders that it started."""
    if process.poll() is None and sys.platform != "win32":
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
    process.kill()
    process.wait()


CLASSES = (CROWDLOD_OT_report_error,)
