"""Update All: Make, Plan, Build or Bake, each where what it rests on has changed.

docs/notes/files.md says what each step rests on, and what a cancel leaves.
"""

import json
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import bpy

from ...crowd_lod.errors import FAULTS, CrowdError
from ...crowd_lod.errors import sentence as fault_sentence
from ...crowd_lod.progress import finished, share, standing
from ..blender import provenance, scene_data
from ..blender.operator import Stepwise
from ..blender.output_folders import full_path
from ..blender.sidebar_answers import hold, keep_at_work
from ..characters.cast_provenance import reading_afresh
from ..lod_meshes.made_for import outdated
from ..lod_meshes.make_lods import make_levels
from ..render_setup import staleness
from ..render_setup.buttons import bake_frames, build_live
from ..render_setup.render_setup import BAKED
from ..scene.scene_crowd import read_crowd
from ..scene.shot_reference import CAMERA, changes_since_plan, reference, stored_plan
from ..settings import needs
from ..shot.planned_cameras import note_cameras, plans_these_cameras
from ..shot.shot_plan import plan_of_settings, requested_of, wanted_of
from ..sources.crowd_sources import live

# About how many seconds each step takes, for the progress.
SEARCHED = 10.0  # the LODs of a character by tolerance
MADE = 3.0  # by distance
REPORTED = 1.5  # a plan's report and files
PLANNED = 3.5e-7  # an agent in a frame
BUILT = 2.0
BAKED_FRAME = 0.03

# what plan.json has of a plan's settings, in words
REQUESTED = {
    "avoid_pops": "Extra Cost for Fewer Pops",
    "budget": "the budget",
}


@dataclass(frozen=True)
class UpdateStep:
    """A step of Update All.

    label: as on its button.
    seconds: that it takes, about.
    find_reason: yields the progress, returns why the step is due, "" if it is not. Its second
        argument says whether all frames are looked at, which steps through the scene.
    work: yields the progress, returns a sentence.
    """

    label: str
    seconds: float
    find_reason: Callable[[bpy.types.Scene, bool], Generator[float, None, str]]
    work: Callable[[bpy.types.Scene], Generator[float, None, str]]


def _make(scene: bpy.types.Scene) -> Generator[float, None, str]:
    outcome = yield from make_levels(scene)
    return outcome.sentence


def _reason_to_make(scene: bpy.types.Scene, thorough: bool) -> Generator[float, None, str]:
    yield 0.0
    if scene.crowd_lod.levels is None:
        return "there are no LOD meshes"
    return outdated(scene)


def _reason_to_plan(scene: bpy.types.Scene, thorough: bool) -> Generator[float, None, str]:
    settings = scene.crowd_lod
    if not settings.shot_plan:
        # A build without a plan is one by distance, which the user chose.
        by_distance = settings.build is not None or live(settings)
        return "" if by_distance else "there is no plan"
    if not settings.use_shot_plan or settings.levels is None:
        return ""
    try:
        changes = yield from _changes_of_plan(scene, thorough)
    except CrowdError as error:  # the file is gone, or spoilt
        return str(error)
    return f"{provenance.name_inputs(changes)} changed" if changes else ""


def _changes_of_plan(scene: bpy.types.Scene, thorough: bool) -> Generator[float, None, list[str]]:
    """Find what has changed since the scene's plan was made; CrowdError if it cannot be read.

    Yields the progress and returns the names.
    """
    settings = scene.crowd_lod
    stored = stored_plan(settings)
    changes = yield from changes_since_plan(read_crowd(scene), films=thorough)
    if not thorough and not plans_these_cameras(scene):
        changes.append(CAMERA)
    if stored.numbers.tolist() != list(scene_data.frames_of(scene)):
        changes.append("the frames")
    now = requested_of(wanted_of(scene, stored.path.parent, stored.numbers))
    before = _requested_before(settings)
    changes += [words for name, words in REQUESTED.items() if before.get(name) != now[name]]
    return list(dict.fromkeys(changes))


def _requested_before(settings) -> dict[str, Any]:
    """Return the settings that the scene's plan was asked for; those of now without plan.json."""
    path = full_path(settings.shot_plan).with_name("plan.json")
    with suppress(OSError, ValueError, LookupError, TypeError):
        return dict(json.loads(path.read_text(encoding="utf-8"))["shot"]["asked"])
    return requested_of(wanted_of(settings.id_data, path.parent, ()))


def _reason_to_build(scene: bpy.types.Scene, thorough: bool) -> Generator[float, None, str]:
    yield 0.0
    if scene.crowd_lod.build is None:
        return "there is no build"
    changes = staleness.compare(scene)
    return f"{provenance.name_inputs(changes)} changed" if changes else ""


def _is_bake(scene: bpy.types.Scene) -> bool:
    build = scene.crowd_lod.build
    return build is not None and BAKED in build


def update_steps(scene: bpy.types.Scene, bakes: bool = False) -> tuple[UpdateStep, ...]:
    """Return the steps of the scene in the order of the work.

    bakes: whether to bake a scene that has no bake.
    """
    settings = scene.crowd_lod
    frames = len(scene_data.frames_of(scene))
    make = SEARCHED if settings.choice == "BY_TOLERANCE" else MADE
    bake = BUILT + BAKED_FRAME * frames
    last = (
        UpdateStep("Bake", bake, partial(_reason_to_bake, bakes), bake_frames)
        if bakes or _is_bake(scene)
        else UpdateStep("Build", BUILT, _reason_to_build, build_live)
    )
    plan = REPORTED + PLANNED * frames * settings.count
    return (
        UpdateStep("Make LOD Meshes", make * len(settings.groups), _reason_to_make, _make),
        UpdateStep("Plan Shot", plan, _reason_to_plan, plan_of_settings),
        last,
    )


def _reason_to_bake(
    bakes: bool, scene: bpy.types.Scene, thorough: bool
) -> Generator[float, None, str]:
    if bakes and not _is_bake(scene):
        return "there is no bake"
    return (yield from _reason_to_build(scene, thorough))


@keep_at_work
def due_steps(scene: bpy.types.Scene) -> dict[str, str]:
    """Return why each step is due, by its label, as far as the sidebar can tell.

    A step that rests on a due one may become due by it. look_again() drops the answer.
    """
    return _due(scene)


@hold(lambda scene: (provenance.changes, reference(scene.crowd_lod)))
def _due(scene: bpy.types.Scene) -> dict[str, str]:
    due = {}
    for step in update_steps(scene):
        with suppress(CrowdError):  # what is wrong is told elsewhere
            if reason := finished(step.find_reason(scene, False)):
                due[step.label] = reason
    return due


def look_again(scene: bpy.types.Scene) -> None:
    """Let the sidebar look again at once."""
    _due.drop(scene)


def update_all(
    scene: bpy.types.Scene, note: Callable[[str], None] = lambda _: None, bakes: bool = False
) -> Generator[float, None, dict[str, str]]:
    """Do the steps that are due, in their order.

    note: called with the label of each step that is done, before the next begins.
    bakes: as for update_steps.

    Yields the progress and returns what each step that was done says, by its label. Closed early,
    it leaves the steps that are done, and undoes the one at work. CrowdError names the step that
    failed.
    """
    yield from standing(reading_afresh(scene), 0.0)
    steps = update_steps(scene, bakes)
    begin = 0.0
    sentences: dict[str, str] = {}
    for k, step in enumerate(steps):
        if (yield from standing(step.find_reason(scene, True), begin)):
            if sentences:
                note(next(reversed(sentences)))
            left = sum(later.seconds for later in steps[k:])
            end = begin + (1 - begin) * step.seconds / left
            try:
                sentences[step.label] = yield from share(step.work(scene), begin, end)
            except FAULTS as fault:
                raise CrowdError(_failed(step.label, sentences, fault)) from fault
            yield from standing(reading_afresh(scene), end)
            begin = end
    if scene.crowd_lod.shot_plan:
        note_cameras(scene)
    look_again(scene)
    return sentences


def _failed(label: str, done: dict[str, str], fault: Exception) -> str:
    """Return a sentence on a step that failed, and on the steps before it, which stay."""
    stays = f" {' and '.join(done)} before it stay{'s' * (len(done) == 1)}." if done else ""
    return f"{label}: {fault_sentence(fault)}{stays}"


def update_sentence(scene: bpy.types.Scene, sentences: dict[str, str]) -> str:
    """Return what was done, and what was up to date."""
    rest = [step.label for step in update_steps(scene) if step.label not in sentences]
    kept = f"Up to date: {', '.join(rest)}." if rest else ""
    return " ".join(
        filter(None, [*(f"{label}: {said}" for label, said in sentences.items()), kept])
    )


class CROWDLOD_OT_update_all(Stepwise, bpy.types.Operator):
    """Make LOD meshes, plan the shot, build or bake: what has changed, and nothing else"""

    bl_idname = "crowd_lod.update_all"
    bl_label = "Update All"
    needs = (needs.crowd, needs.camera)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        finished_steps: list[str] = []

        def note(label: str) -> None:
            finished_steps.append(label)
            self.remains = f"{' and '.join(finished_steps)} stay"
            if bpy.ops.ed.undo_push.poll():  # each step can be undone alone
                bpy.ops.ed.undo_push(message=label)

        done = yield from update_all(scene, note)
        if not done:
            return update_sentence(scene, done)
        for label, said in done.items():
            self.report({"INFO"}, f"{label}: {said}")
        # the status bar cuts the middle out of a long sentence
        return f"{', '.join(done)}: done. {scene.crowd_lod.shot_verdict}".strip()


CLASSES = (CROWDLOD_OT_update_all,)
