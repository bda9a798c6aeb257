"""Proof by renders: the same frames with and without culling and LOD, compared; and its button."""

from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.frame.frame_range import spread_evenly
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.frame.planned import unplanned_notes
from ....crowd_lod.output import tables
from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.output.frame_parts import FrameParts
from ....crowd_lod.output.verify_report import verify_page
from ....crowd_lod.progress import Workload, run_in_thread, unsure
from ....crowd_lod.validation.render_proof import is_ok, verdict, worst_agent, worst_frame
from ...blender import cameras, evaluation, image_data, removal, scene_data
from ...blender.operator import Reporting, Stepwise
from ...blender.output_folders import output_folder, place_of
from ...build import frame_update
from ...freshness.artifacts import ProofResult, note_proof, proof_parts
from ...lods.costs import lacking_seconds
from ...lods.make_lods import make_levels
from ...scene.characters.characters import glowing
from ...scene.characters.group_measuring import measuring_groups
from ...scene.characters.stored_groups import groups_of, store_groups
from ...scene.lights import has_sky
from ...scene.scene_crowd import SceneCrowd, characters_of, read_crowd
from ...scene.shot_reference import frame_of, moment_now
from ...scene.sources.record_points import on_record
from ...settings import needs
from ...viewport.playblast import show_image
from ..preview import preview_stage
from ..preview.lettering import labeled_sheet
from ..preview.shared_frames import ALONE, Sharing, make_frames, state_of
from .frame_proof import Proof
from .verify_build import BAKE, ProvedBuild, build_of, frames_to_verify
from .verify_notes import never_shown, unjudged, unlike_renders, what_is_not_proved
from .verify_pictures import AMPLIFIED, PICTURES, TITLES
from .verify_stage import Verify, set_up_cycles, without_shadows

PROVED = 20.0  # seconds that proving a frame takes, about
# Settings of the crowd that a proof sets for a while, by making LODs and storing groups, too. The
# others are the user's meanwhile.
SET_MEANWHILE = (
    *("build", "levels", "dropped", "memory_tolerance", "memory_made"),
    *("estimate", "shot_budgets"),
)
MOST_PROVED_IN_SHEET = 8  # frames on the contact sheet
THUMBNAIL = 480  # pixels across its pictures


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
        size = task.size(scene)
        sky = has_sky(scene) and scene.crowd_lod.sky_light
        _set_up(scene, task, proved, opened)
        crowd = yield from work.take(unsure(prepare_crowd(scene)), making)
        sharing.save(folder)
        with evaluation.step_frames(scene) as at:
            run = Proof(crowd, task, folder, at, size, proved, sky)
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
    opened.enter_context(preview_stage.restore_settings(*owners))
    opened.enter_context(preview_stage.restore_settings(settings, only=SET_MEANWHILE))
    opened.callback(if_there, store_groups, settings, groups_of(settings))
    opened.callback(if_there, setattr, scene, "world", scene.world)


def _set_up(scene: bpy.types.Scene, task: Verify, proved: ProvedBuild, opened: ExitStack) -> None:
    """Set `scene` up for the proof's renders until `opened` closes."""
    if proved.kind == BAKE and scene.render.engine == "BLENDER_WORKBENCH":
        opened.enter_context(without_shadows(scene))
    _aim_nowhere(scene, opened)
    set_up_cycles(scene, task)
    scene.view_layers[0].update()


def prepare_crowd(scene: bpy.types.Scene) -> Generator[float, None, SceneCrowd]:
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
        opened.enter_context(
            preview_stage.restore_settings(material.cycles, only=("emission_sampling",))
        )
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
            tiles.append(_thumbnail(image_data.load_pixels(path)))
            yield 0.0
    labels = [f"Frame {number}" for number in frames]
    sheet = yield from labeled_sheet(tiles, len(TITLES), TITLES, labels)
    yield from run_in_thread(partial(save_png, folder / "contact_sheet.png", sheet))


def _thumbnail(picture: np.ndarray) -> np.ndarray:
    """Return a picture (rows, columns, 4) as it stands in the contact sheet, THUMBNAIL wide."""
    rows, columns = picture.shape[:2]
    high = max(1, round(THUMBNAIL * rows / columns))
    row = np.arange(high) * rows // high
    column = np.arange(THUMBNAIL) * columns // THUMBNAIL
    return picture[row[:, None], column]


def _result(
    scene: bpy.types.Scene, task: Verify, command: list[str], frames: list[dict]
) -> dict[str, Any]:
    """Return the dict of verify.json, as far as it follows from what the frames tell."""
    rows = [frame["row"] for frame in frames]
    unplanned = [tuple(frame["unplanned"]) for frame in frames]
    notes = unjudged(scene, rows)
    if any(why for _, why in unplanned):
        notes.append(unplanned_notes(unplanned))
    return {
        "version": 1,
        "command": command,
        "width": task.size(scene)[0],
        "samples": task.samples,
        "pictures": PICTURES,
        "amplified": AMPLIFIED,
        "frames": rows,
        **{kind: _of_all(frames, kind) for kind in ("agents", "patches", "shades")},
        "groups": [group.name for group in scene.crowd_lod.groups],
        "build": None,
        "left_out": notes,
    }


def _of_all(frames: list[dict], kind: str) -> list[dict[str, Any]]:
    """Return what all frames tell of agents, patches or shades, and of which frame that is."""
    return [{"frame": each["row"]["frame"], **told} for each in frames for told in each[kind]]


def _describe_build(proved: ProvedBuild, rows: list[dict]) -> dict[str, Any]:
    """Return what verify.json tells of the build: its kind, and what changed since it was made."""
    older = [name for row in rows for name in row["older_than"].split(", ") if name]
    changed = list(dict.fromkeys([*proved.changed, *older]))
    return {"kind": proved.kind, "older_than": changed, "hidden": proved.hidden}


PROOF_IMAGE = "Crowd LOD Proof"


def _show_places(path: Path) -> None:
    """Keep the picture of the worst places in the file as PROOF_IMAGE, for the Image Editor."""
    image = bpy.data.images.get(PROOF_IMAGE) or bpy.data.images.load(str(path))
    image.name = PROOF_IMAGE
    image.use_fake_user = True  # nothing else uses it
    if image.packed_file is not None:
        image.unpack(method="REMOVE")
    image.filepath = str(path)
    image.reload()
    image.pack()


class CROWDLOD_OT_verify(Stepwise, bpy.types.Operator):
    bl_description = (
        "Render a few frames as built and at full detail, compare them, and write a report"
    )
    bl_idname = "crowd_lod.verify"
    bl_label = "Verify"
    renders = True
    bl_options = {"REGISTER"}
    needs = (needs.characters, needs.camera)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        frames = frames_to_verify(scene, scene_data.frames_of(scene))
        task = Verify(
            frames=spread_evenly(frames, settings.verify_count),
            folder=output_folder(scene, "verify"),
        )
        made_of = proof_parts(scene)
        result = yield from verify(scene, task, ["sidebar"])
        _show_places(task.folder / f"frame_{worst_frame(result):04d}_places.png")
        found = verdict(result)
        note_proof(scene, ProofResult(found, result["ok"], made_of, worst_agent(result)))
        sentence = f"{found} The report is in {place_of(task.folder)}."
        if not result["ok"]:
            raise CrowdError(sentence)  # the report stays
        return sentence


def _no_proof(scene: bpy.types.Scene) -> str:
    return "" if PROOF_IMAGE in bpy.data.images else "There is no proof yet: press Verify"


class CROWDLOD_OT_show_proof(Reporting, bpy.types.Operator):
    """Show the worst places of the last proof: at full detail, as built, and where they differ"""

    bl_idname = "crowd_lod.show_proof"
    bl_label = "Show Proof"
    bl_options = {"REGISTER"}
    needs = (_no_proof,)

    def run(self, context) -> str:
        show_image(PROOF_IMAGE)
        return f"A window shows the image {PROOF_IMAGE}."


CLASSES = (CROWDLOD_OT_verify, CROWDLOD_OT_show_proof)
