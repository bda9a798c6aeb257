"""Proof by renders: the same frames with and without culling and LOD, compared."""

from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import unplanned_notes
from ...crowd_lod.output import tables
from ...crowd_lod.output.frame_parts import FrameParts
from ...crowd_lod.output.png_file import save_png
from ...crowd_lod.output.verify_report import verify_page
from ...crowd_lod.progress import Workload, run_in_thread, unsure
from ...crowd_lod.validation.render_proof import is_ok
from ..blender import cameras, cleanup, frame_stepping, image_data, removal, scene_data
from ..characters.glow import glowing
from ..characters.group_measuring import measuring_groups
from ..characters.stored_groups import groups_of, store_groups
from ..lod_meshes.costs import lacking_seconds
from ..lod_meshes.make_lods import make_levels
from ..render_setup import frame_update
from ..scene.frame_plan import frame_of, moment_now
from ..scene.scene_crowd import SceneCrowd, characters_of, read_crowd
from ..sources.record_points import on_record
from .frame_proof import Proof
from .lettering import labeled_sheet
from .lone_agents import LoneStage
from .shared_frames import ALONE, Sharing, make_frames, state_of
from .verify_build import (
    BAKE,
    ProvedBuild,
    build_of,
)
from .verify_notes import never_shown, unjudged, unlike_renders, what_is_not_proved
from .verify_pictures import AMPLIFIED, PICTURES, TITLES
from .verify_stage import (
    Verify,
    set_up_cycles,
    without_shadows,
)

PROVED = 20.0  # seconds that proving a frame takes, about
# Settings of the crowd that a proof sets for a while, by making LODs and storing groups, too. The
# others are the user's meanwhile.
SET_MEANWHILE = (
    *("build", "levels", "dropped", "memory_tolerance", "memory_made"),
    *("estimate", "shot_budgets"),
)
MOST_PROVED_IN_SHEET = 8  # frames on the contact sheet


@on_record(lambda scene, task, *_: task.frames)
def verify(
    scene: bpy.types.Scene, task: Verify, command: list[str], sharing: Sharing = ALONE
) -> Generator[float, None, dict[str, Any]]:
    """Write the proof for `scene`: yield the progress, return verify.json's dict.

    What is proved is the scene's bake, else its live build, else one that is made for the proof.
    The scene itself is stepped and rendered, because a copy lacks some of what its frames show.
    Afterwards it is restored. The folder gets its files at the end, all or none.

    command: the command line of the run, for verify.json.
    sharing: which part of it is done here; of a part of the frames, only their rows are returned.
    """
    _check_cycles(scene)
    with ExitStack() as opened:
        folder = opened.enter_context(sharing.opened(task.folder))
        _restore_afterwards(scene, opened)
        # what is missing is named before anything is set
        cameras.active_camera(scene)
        characters_of(scene)
        left_out = never_shown(scene)
        not_proved = what_is_not_proved(scene, task)
        frames_proved = task.frames if sharing.part is None else sharing.part
        making = lacking_seconds(scene)
        proving = PROVED * len(frames_proved)
        work = Workload(making + proving)
        proved = yield from work.take(build_of(scene, frames_proved))
        left_out += unlike_renders(scene, proved)
        size = _set_up(scene, task, proved, opened)
        crowd = yield from work.take(unsure(_prepare_crowd(scene)), making)
        sharing.save(folder)
        with frame_stepping.step_frames(scene) as at:
            run = Proof(crowd, task, folder, at, size, proved, LoneStage(scene, folder))
            frames = yield from work.take(_prove_frames(run, sharing), proving)
        if sharing.part is not None:
            return {"frames": [frame["row"] for frame in frames], "ok": True}
        result = _result(scene, task, command, frames)
        result["build"] = _describe_build(proved, result["frames"])
        result["left_out"] = left_out + result["left_out"]
        result["not_proved"] = not_proved
        result["ok"] = is_ok(result)
        yield from work.take(_write(run, result))
        return result


def _check_cycles(scene: bpy.types.Scene) -> None:
    if not hasattr(scene, "cycles"):
        raise CrowdError(
            "The frames are rendered with Cycles: enable the add-on Cycles Render Engine in the "
            "preferences."
        )


def _restore_afterwards(scene: bpy.types.Scene, opened: ExitStack) -> None:
    """Restore the scene and its settings, and remove what was made, when `opened` closes."""
    settings = scene.crowd_lod

    def if_there(put_back: Callable[..., Any], *arguments: Any) -> None:
        if removal.is_there(scene):
            put_back(*arguments)

    # a live build was shown other frames
    opened.callback(if_there, lambda: frame_update.follow(scene, scene.view_layers[0].depsgraph))
    opened.enter_context(removal.scratch())
    owners = (
        scene.render,
        scene.render.image_settings,
        scene.cycles,
        scene.display,
        scene.view_settings,
        *scene.view_layers,
        *filter(None, (settings.build, settings.characters)),
    )
    opened.enter_context(cleanup.restore_settings(*owners))
    opened.enter_context(cleanup.restore_settings(settings, only=SET_MEANWHILE))
    opened.callback(if_there, store_groups, settings, groups_of(settings))
    opened.callback(if_there, setattr, scene, "world", scene.world)


def _set_up(
    scene: bpy.types.Scene, task: Verify, proved: ProvedBuild, opened: ExitStack
) -> tuple[int, int]:
    """Set `scene` up for the proof's renders until `opened` closes; return their size, pixels."""
    if proved.kind == BAKE and scene.render.engine == "BLENDER_WORKBENCH":
        opened.enter_context(without_shadows(scene))
    _aim_nowhere(scene, opened)
    size = set_up_cycles(scene, task)
    scene.view_layers[0].update()
    return size


def _prepare_crowd(scene: bpy.types.Scene) -> Generator[float, None, SceneCrowd]:
    """Measure the characters, and make LODs where there are none.

    Yields the progress and returns the crowd. CrowdError if something is wrong with the scene: it
    is said before the work begins.
    """
    settings = scene.crowd_lod
    work = Workload(1)
    store_groups(settings, (yield from work.take(measuring_groups(scene))))
    crowd = read_crowd(scene)
    yield from work.take(approach(crowd.trajectory, scene_data.time_of(scene)))
    frame_of(crowd, moment_now(scene, scene.view_layers[0].depsgraph))
    if settings.levels is None:
        yield from work.take(make_levels(scene), 1)
        crowd = read_crowd(scene)  # its groups have LODs now
    return crowd


def _prove_frames(run: Proof, sharing: Sharing) -> Generator[float, None, list[dict[str, Any]]]:
    """Prove the frames: yield the progress, return what is told of each (see FrameParts.store)."""
    frames = run.task.frames
    parts = FrameParts(run.folder, state_of(run.crowd, run.task))
    with sharing.helped(run.folder, frames) as helpers:
        making = make_frames(parts, frames, sharing, run.prepare, run.prove, helpers)
        return (yield from making)


def _aim_nowhere(scene: bpy.types.Scene, opened: ExitStack) -> None:
    """Aim no rays at what glows until `opened` closes.

    Where fewer agents glow, aimed rays would meet others: the noise would differ.
    """
    for material in {material for worn in glowing(scene).values() for material in worn}:
        opened.enter_context(cleanup.restore_settings(material.cycles, only=("emission_sampling",)))
        material.cycles.emission_sampling = "NONE"


def _write(run: Proof, result: dict[str, Any]) -> Iterator[float]:
    """Write the proof's files: its figures, its report, and a sheet of pictures.

    Yields the progress.
    """
    folder = run.folder
    title = Path(bpy.data.filepath).stem or run.scene.name
    (folder / "verify.json").write_text(tables.to_json(result), encoding="utf-8")
    (folder / "verify.csv").write_text(tables.to_csv(result["frames"]), encoding="utf-8")
    (folder / "report.html").write_text(verify_page(title, result), encoding="utf-8")
    frames = spread_evenly(run.task.frames, MOST_PROVED_IN_SHEET)
    tiles = []
    for number in frames:
        for path in run.pictures(number):
            tiles.append(image_data.load_pixels(path))
            yield 0.0
    lights = ("", "\nwith bounces") if run.task.bounces else ("",)
    labels = [f"Frame {number}{light}" for number in frames for light in lights]
    sheet = yield from labeled_sheet(tiles, len(TITLES), TITLES, labels)
    yield from run_in_thread(partial(save_png, folder / "contact_sheet.png", sheet))


def _result(
    scene: bpy.types.Scene, task: Verify, command: list[str], frames: list[dict]
) -> dict[str, Any]:
    """Return the dict of verify.json, as far as it follows from what the frames tell."""
    rows = [frame["row"] for frame in frames]
    unplanned = [tuple(frame["unplanned"]) for frame in frames]
    notes = unjudged(scene, rows, task)
    if any(why for _, why in unplanned):
        notes.append(unplanned_notes(unplanned))
    return {
        "version": 1,
        "command": command,
        "width": task.width,
        "samples": task.samples,
        "bounces": task.bounces,
        "pictures": PICTURES,
        "amplified": AMPLIFIED,
        "frames": rows,
        "agents": [
            {"frame": frame["row"]["frame"], **agent}
            for frame in frames
            for agent in frame["agents"]
        ],
        "build": None,
        "left_out": notes,
    }


def _describe_build(proved: ProvedBuild, rows: list[dict]) -> dict[str, Any]:
    """Return what verify.json tells of the build: its kind, and what changed since it was made."""
    older = [name for row in rows for name in row["older_than"].split(", ") if name]
    changed = list(dict.fromkeys([*proved.changed, *older]))
    return {"kind": proved.kind, "older_than": changed, "hidden": proved.hidden}
