"""Batch preview: two pictures and a table row per frame, plan, contact sheet."""

import contextlib
import time as clock
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.format import counted, number
from ....crowd_lod.frame.frame import Frame
from ....crowd_lod.frame.frame_range import spread_evenly
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.frame.planned import note_of, unplanned_notes
from ....crowd_lod.levels.assignment import deviations
from ....crowd_lod.output import files, tables
from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.output.frame_parts import FrameParts
from ....crowd_lod.output.html_report import page
from ....crowd_lod.output.shot_page import preview_page
from ....crowd_lod.progress import Workload, run_in_thread, unsure
from ....crowd_lod.shot import plan_file
from ....crowd_lod.shot.pixels import worst_error
from ...blender import cameras, evaluation, image_data, removal, scene_data
from ...blender.operator import Stepwise
from ...blender.output_folders import output_folder, place_of
from ...freshness.artifacts import to_make_again
from ...lods.costs import lacking_seconds
from ...lods.deviation import measure_levels
from ...lods.make_lods import make_levels
from ...plan.shot_plan import (
    PlannedShot,
    plan_seconds,
    plan_shot,
    shot_json,
    wanted_of,
    write_levels,
)
from ...scene import lights
from ...scene.characters.character_provenance import reading
from ...scene.characters.group_measuring import measuring_groups
from ...scene.characters.stored_groups import groups_of, store_groups
from ...scene.plan_verdict import verdict_in_words
from ...scene.scene_crowd import SceneCrowd, characters_of, read_crowd
from ...scene.shot_reference import frame_of, moment_now
from ...scene.sources.record_points import on_record
from ...settings import needs
from ...viewport.appearance import colors_of
from ...viewport.draw_data import FRUSTUM, by_level
from ...viewport.playblast import Playblast, need_gpu
from . import lod_table, top_view
from .lettering import Legend, labeled_sheet
from .preview_plan import plan_json
from .preview_stage import Preview, Rendered, Staged, leaves_out, shade, sized, staged
from .shared_frames import ALONE, Sharing, make_frames, state_of

MOST_IN_SHEET = 24  # frames on the contact sheet
# Seconds, about: the pictures of a frame, a LOD's picture and its row in the table.
FRAME = 4.0
LOD = 2.0
BEHAVIOR = 0.9  # of a frame's time, where the way to it is long
# agents times frames that a preview plans first; longer shots take Plan Shot
MOST_PLANNED = 30_000_000
LEFT_OUT = "The characters themselves are left out of the pictures (see Render Source Characters)."
THUMBNAIL = 480  # pixels wide, at least


@on_record(lambda scene, task, *_: task.frames)
def preview(
    scene: bpy.types.Scene, task: Preview, command: list[str], sharing: Sharing = ALONE
) -> Generator[float, None, dict[str, Any]]:
    """Write the preview of `scene`: yield the progress, return the plan's dict.

    All is made in a copy of the scene, which is removed afterwards. The folder gets its files at
    the end, all or none.

    command: the command line of the run, for plan.json.
    sharing: which part of it is done here; of a part of the frames, only their rows are returned.
    """
    with (
        sharing.opened(task.folder) as folder,
        removal.scratch(),
        contextlib.ExitStack() as opened,
    ):
        started = clock.perf_counter()
        _check(scene, task)
        lacking = lacking_seconds(scene)
        describing = LOD * scene.crowd_lod.level_count * len(characters_of(scene))
        work = Workload(lacking + describing + FRAME * len(task.frames))
        if sharing.jobs > 1:  # all processes take the LODs from the file
            yield from work.take(unsure(_with_levels(scene)), lacking)
            sharing.save(folder)
        on = staged(scene, task)
        yield from work.take(unsure(_with_levels(on.stage)), lacking_seconds(on.stage))
        plan_folder = (
            folder if sharing.part is None else opened.enter_context(files.temporary_folder())
        )
        crowd = read_crowd(on.stage)  # the LODs are there now
        lacks_plan = _lacks_plan(crowd, task)
        planning = plan_seconds(on.stage, _span(task)) if lacks_plan else 0.0
        work.announce(planning + _describing_seconds(crowd) + FRAME * len(task.frames))
        shot = None
        if lacks_plan:
            shot = yield from work.take(unsure(_plan(crowd, task, plan_folder)), planning)
        run = _begin(crowd, on, folder, opened)
        lods, frames, legends = yield from _picture(run, sharing, work)
        if sharing.part is not None:
            return {"frames": [frame["row"] for frame in frames]}
        plan = yield from work.take(_describe(run, command, lods, frames))
        if shot is not None:
            plan |= {key: shot_json(shot)[key] for key in ("made_of", "shot")}
        plan["seconds"] = round(clock.perf_counter() - started, 3)
        yield from work.take(_write(run, frames, plan, shot, legends))
        return plan


def _check(scene: bpy.types.Scene, task: Preview) -> None:
    """Raise CrowdError if the scene lacks what its preview shows.

    Called with the user's own scene, so that the message names that and not the stage.
    """
    cameras.active_camera(scene)
    characters_of(scene)
    if task.engine == "OVERLAY":
        need_gpu()


def _begin(crowd: SceneCrowd, on: Staged, folder: Path, opened: contextlib.ExitStack) -> "_Run":
    """Return the run that pictures the stage's frames, until `opened` closes."""
    stage = on.stage
    stage.timeline_markers.clear()  # they would take the camera back in the picture from above
    shots: Playblast | Rendered
    if on.task.engine == "OVERLAY":
        shots = opened.enter_context(Playblast(crowd, on.size))
    else:
        shots = Rendered(crowd, on.task)
    at = opened.enter_context(evaluation.step_frames(on.scene))
    return _Run(crowd, on, folder, shots, at, top_view.drawing_in(stage))


def _picture(
    run: "_Run", sharing: Sharing, work: Workload
) -> Generator[float, None, tuple[list[dict], list[dict], list[Legend]]]:
    """Picture the LODs and the frames: yield the progress.

    Returns (what is told of the LODs, what is told of each frame, see FrameParts.store, the
    legends of the pictures' colors).
    """
    frames = run.on.task.frames
    parts = FrameParts(run.folder, state_of(run.crowd, run.on.task))
    lods = []
    legends = []
    with sharing.helped(run.folder, frames) as helpers:
        if sharing.part is None:  # while other processes make frames
            first = yield from work.take(run.at_first())
            legends = legends_of(run.on.task.color, first)
            describing = lod_table.tables(run.crowd, first.camera, first.thresholds, run.folder)
            lods = yield from work.take(unsure(describing), _describing_seconds(run.crowd))
        making = make_frames(parts, frames, sharing, run.shots.prepare, run.shoot, helpers)
        pictured = yield from work.take(making, work.left)
    return lods, pictured, legends


def _describe(
    run: "_Run", command: list[str], lods: list[dict], frames: list[dict]
) -> Generator[float, None, dict[str, Any]]:
    """Return what plan.json says of the preview, without a shot plan; yields the progress."""
    yield from reading(run.on.stage)
    rows = [frame["row"] for frame in frames]
    unplanned = unplanned_notes([tuple(frame["unplanned"]) for frame in frames])
    settings = run.on.stage.crowd_lod
    follows_plan = settings.shot_plan and settings.use_shot_plan and not unplanned
    notes = (
        *run.shots.notes,
        tables.nobody_seen(row["visible"] for row in rows),
        unplanned,
        to_make_again(run.on.stage),
        leaves_out(run.on.scene) and LEFT_OUT,
        evaluation.describe_unbaked(run.on.scene),
    )
    plan = yield from plan_json(run.crowd, run.on, command, rows, lods, tuple(filter(None, notes)))
    plan["preview"]["verdict"] = verdict_in_words(settings) if follows_plan else ""
    return plan


def _write(
    run: "_Run",
    frames: list[dict],
    plan: dict[str, Any],
    shot: PlannedShot | None,
    legends: list[Legend],
) -> Iterator[float]:
    """Write the preview's files: its table, its plan, its report, and a sheet of pictures.

    Yields between steps.
    """
    folder = run.folder
    report = page(plan) if shot is None else preview_page(shot.report, plan)
    rows = [frame["row"] for frame in frames]
    (folder / "frames.csv").write_text(tables.to_csv(rows), encoding="utf-8")
    (folder / "plan.json").write_text(tables.to_json(plan), encoding="utf-8")
    (folder / "report.html").write_text(report, encoding="utf-8")
    pictures = [run.pictures(number) for number in run.on.task.frames]
    sheet = yield from _sheet(pictures, legends)
    yield from run_in_thread(partial(save_png, folder / "contact_sheet.png", sheet))


def _with_levels(stage: bpy.types.Scene) -> Iterator[float]:
    """Measure the characters, and make or measure LODs where they lack; yields the progress.

    CrowdError if something is wrong with the scene: it is said before the work begins.
    """
    layer = stage.view_layers[0]
    settings = stage.crowd_lod
    layer.update()
    work = Workload(1)
    store_groups(settings, (yield from work.take(measuring_groups(stage))))
    crowd = read_crowd(stage)
    yield from work.take(approach(crowd.trajectory, scene_data.time_of(stage)))
    frame_of(crowd, moment_now(stage, layer.depsgraph))
    if settings.levels is not None and deviations(groups_of(settings), crowd.policy) is not None:
        return
    making = make_levels(stage) if settings.levels is None else measure_levels(stage)
    yield from work.take(making, 1)


def _describing_seconds(crowd: SceneCrowd) -> float:
    """Return about how many seconds the LODs' pictures and rows take."""
    return LOD * lod_table.count_pictured(crowd.trajectory.groups)


def _span(task: Preview) -> range:
    """Return all frames from the preview's first to its last."""
    return range(task.frames[0], task.frames[-1] + 1)


def _lacks_plan(crowd: SceneCrowd, task: Preview) -> bool:
    """Return whether the preview plans its shot: the scene has no plan, and there is one to make.

    There is none of one frame or one LOD. Too much is left to Plan Shot.
    """
    most = MOST_PLANNED / max(len(crowd.trajectory.start), 1)
    return not crowd.settings.shot_plan and crowd.policy.count > 1 and 1 < len(_span(task)) <= most


def _plan(crowd: SceneCrowd, task: Preview, folder: Path) -> Generator[float, None, PlannedShot]:
    """Plan the shot of the preview's frames, which the stage then follows: yield the progress,
    return it.
    """
    stage = crowd.scene
    settings = crowd.settings
    planned = yield from plan_shot(stage, wanted_of(stage, folder, _span(task)))
    write_levels(folder, planned)
    settings.shot_plan = str(folder / plan_file.NAME)
    settings.use_shot_plan = True
    return planned


@dataclass
class _Run:
    """A preview while it is made.

    crowd: that of the stage.
    folder: where the files lie until all are made.
    at: steps the scene.
    drawing: shows the crowd from above.
    view: the camera above, once it is known.
    """

    crowd: SceneCrowd
    on: Staged
    folder: Path
    shots: Playblast | Rendered
    at: evaluation.At
    drawing: bpy.types.Object
    view: bpy.types.Object | None = None

    def pictures(self, number: int) -> tuple[Path, Path]:
        """Return the files of the two pictures of a frame."""
        return self.folder / f"main_{number:04d}.png", self.folder / f"above_{number:04d}.png"

    def shoot(
        self, number: int
    ) -> Generator[float, None, tuple[dict[str, Any], tuple[Path, Path]]]:
        """Write the two pictures of the timeline's frame `number`.

        Yields the progress and returns (what is told of it, the pictures); see FrameParts.store.
        """
        stage = self.on.stage
        main, above = self.pictures(number)
        steps = Workload(1.0)
        yield from steps.take(self.approach(number), BEHAVIOR)
        frame = yield from steps.take(self.planned(number))
        caption = stage.render.stamp_note_text = _caption(frame)
        took = {}
        for part, work in (
            ("points", partial(self.shots.place, frame)),
            ("main", partial(self._shoot_main, main, caption)),
            ("above", partial(self._shoot_above, frame, above, caption)),
        ):
            yield steps.did(0.0)
            began = clock.perf_counter()
            work()
            took[part] = 1000 * (clock.perf_counter() - began)
        facts = {
            "row": tables.row(number, frame, took),
            "unplanned": note_of(number, frame.unplanned, self.on.task.strict),
        }
        return facts, (main, above)

    def approach(self, number: int) -> Generator[float, None, None]:
        """Let the crowd walk on to the frame: yield the progress."""
        return approach(self.crowd.trajectory, scene_data.remap(self.on.scene.render, number))

    def at_first(self) -> Generator[float, None, Frame]:
        """Return the plan of the first frame; yield the progress of the way there."""
        yield from self.approach(self.on.task.frames[0])
        return (yield from self.planned(self.on.task.frames[0]))

    def planned(self, number: int) -> Generator[float, None, Frame]:
        """Set the stage to the frame: yield between steps, return its plan."""
        scene = self.on.scene
        stage = self.on.stage
        depsgraph = self.on.stage.view_layers[0].depsgraph
        time = scene_data.remap(scene.render, number)
        stage.camera = cameras.still(cameras.bound_camera(scene, time), self.at((), time))
        scene.update_tag()  # what is driven by the scene follows it in the stage, too
        self.drawing.hide_render = self.drawing.hide_viewport = True
        yield 0.0
        stage.frame_set(number)
        yield from reading(stage)
        around = lights.read_surroundings(stage, depsgraph, number)
        return frame_of(read_crowd(stage), moment_now(stage, depsgraph, around))

    def _shoot_main(self, path: Path, caption: str) -> None:
        stage = self.on.stage
        shade(stage, "TEXTURE" if self.on.task.color == "MATERIAL" else "OBJECT", "STUDIO")
        with sized(stage.render, self.on.size):
            self.shots.main(path, caption)

    def _shoot_above(self, frame: Frame, path: Path, caption: str) -> None:
        stage = self.on.stage
        layer = self.on.stage.view_layers[0]
        camera = self.on.stage.camera
        self.view = self.view or top_view.straight_down(stage, frame.trajectory.area, frame.camera)
        with sized(stage.render, self.on.size):
            layer.update()
            above = cameras.camera_from(self.view, stage.render, layer.depsgraph)
            top_view.draw_crowd(self.drawing.data, frame, above, scene_data.meters(stage))
            self.drawing.hide_render = self.drawing.hide_viewport = False
            shade(stage, "VERTEX", "FLAT")
            stage.camera = self.view
            self.shots.above(path, caption)
            stage.camera = camera


def _caption(frame: Frame) -> str:
    visible = len(frame.without_worn(frame.buckets).order)
    error = worst_error(frame)
    worst = "" if error is None else f", at most {number(error)} px off"
    return f"{visible:,} of {frame.people:,} in sight, {frame.triangles:,} triangles{worst}"


def verdict_in(plan: dict[str, Any]) -> str:
    """Return the verdict on the shot, by the preview's plan or the scene's own; "" without one."""
    return plan["shot"]["verdict"]["sentence"] if "shot" in plan else plan["preview"]["verdict"]


def legends_of(color: str, frame: Frame) -> list[Legend]:
    """Return what the colors of the camera's pictures mean, and those of the pictures from above.

    color: of Preview. frame: any of the shot.
    """
    by_lod = by_level(frame)
    lods = [(name, by_lod.of_name(k)) for k, name in enumerate(by_lod.names)]
    above: Legend = [
        ("From above:", None),
        *lods,
        ("culled", top_view.CULLED),
        ("camera's view", FRUSTUM),
        ("lines: where LODs begin", by_lod.of_name(1)),
    ]
    if color == "MATERIAL":
        return [above]
    colors = colors_of(color, frame, ())
    names = [(name, colors.of_name(k)) for k, name in enumerate(colors.names)]
    return [[("From the camera:", None), *names], above]


def in_sight(rows: list[dict[str, Any]]) -> str:
    """Return in a sentence how many agents the frames of plan.json show."""
    counts = [row["visible"] for row in rows]
    least = min(counts)
    most = max(counts)
    span = f"{least:,}" if least == most else f"{least:,} to {most:,}"
    return f"{span} of {rows[0]['agents']:,} agents in sight, {counted(len(rows), 'frame')}."


def _sheet(
    pictures: list[tuple[Path, Path]], legends: list[Legend]
) -> Generator[float, None, np.ndarray]:
    """Make the contact sheet, two frames in a row; yield between steps.

    An odd number of frames has one in a row, so that no place stays empty. Each has its main
    picture and the picture from above. Of a long shot it has MOST_IN_SHEET
    frames, evenly spaced.
    """
    pairs = spread_evenly(pictures, MOST_IN_SHEET)
    shrunk = []
    for path in (path for pair in pairs for path in pair):
        yield 0.0
        pixels = image_data.load_pixels(path)
        shrunk.append((yield from run_in_thread(partial(tables.shrink, pixels, THUMBNAIL))))
    return (yield from labeled_sheet(shrunk, 2 if len(pairs) % 2 else 4, legends=legends))


class CROWDLOD_OT_preview(Stepwise, bpy.types.Operator):
    """Render pictures from the camera and from above, with a report, into a folder"""

    bl_idname = "crowd_lod.preview"
    bl_label = "Preview"
    renders = True
    bl_options = {"REGISTER"}
    needs = (
        needs.characters,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        task = Preview(
            frames=scene_data.frames_of(scene, settings.step),
            folder=output_folder(scene, "preview"),
            width=settings.width,
        )
        plan = yield from preview(scene, task, ["sidebar"])
        sentence = (
            f"{counted(len(task.frames), 'frame is', 'frames are')} in {place_of(task.folder)}."
        )
        sentence = f"{verdict_in(plan)} {sentence}".lstrip()
        return f"{sentence} {LEFT_OUT}" if leaves_out(scene) else sentence


CLASSES = (CROWDLOD_OT_preview,)
