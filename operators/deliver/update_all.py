"""Update All: Populate, Make, Plan, Build or Bake, each where what it rests on has changed.

docs/notes/files.md says what each step rests on, and what a cancel leaves.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass

import bpy

from ...crowd_lod.errors import FAULTS, CrowdError
from ...crowd_lod.errors import sentence as fault_sentence
from ...crowd_lod.progress import Workload
from ..blender import scene_data
from ..blender.operator import Stepwise
from ..blender.provenance import name_inputs
from ..blender.steps import note_doing
from ..build.buttons import bake_frames, build_live
from ..freshness.artifacts import (
    BAKE,
    BUILD,
    CROWD,
    LODS,
    PLAN,
    Artifact,
    look_again,
    reason_in,
    reason_of,
    reasons,
)
from ..freshness.bake_frames import is_bake
from ..lods.costs import lod_seconds
from ..lods.make_lods import make_levels
from ..plan.shot_plan import plan_of_settings, plan_seconds
from ..scene.characters.character_provenance import reading_afresh
from ..scene.characters.motionless import check_answered
from ..scene.plan_verdict import verdict_in_words
from ..scene.populate import populate_scene
from ..scene.scene_crowd import read_crowd
from ..scene.shot_reference import changes_since_plan
from ..settings import needs

# About how many seconds each step takes, for the progress.
MEASURED = 1.0  # a character
BUILT = 2.0
BAKED_FRAME = 0.03


@dataclass(frozen=True)
class UpdateStep:
    """A step of Update All.

    artifact: what it makes.
    seconds: returns about how many it takes.
    work: yields the progress, returns a sentence.
    """

    artifact: Artifact
    seconds: Callable[[bpy.types.Scene], float]
    work: Callable[[bpy.types.Scene], Generator[float, None, str]]

    @property
    def label(self) -> str:
        return self.artifact.label


def _populate(scene: bpy.types.Scene) -> Generator[float, None, str]:
    before = [group.name for group in scene.crowd_lod.groups]
    said, warnings = yield from populate_scene(scene)
    now = [group.name for group in scene.crowd_lod.groups]
    others = (
        [] if now == before else [f"The groups were {', '.join(before)}: {', '.join(now)} now."]
    )
    return " ".join([said, *others, *warnings])


def _make(scene: bpy.types.Scene) -> Generator[float, None, str]:
    outcome = yield from make_levels(scene)
    return outcome.sentence


def _reason(scene: bpy.types.Scene, step: UpdateStep, bakes: bool) -> Generator[float, None, str]:
    """Find why the step is due: yield the progress, return it, "" if it is not.

    Of a plan all frames are looked at, which steps through the scene.
    """
    if bakes and step.artifact is BAKE and not is_bake(scene.crowd_lod.build):
        return "there is no bake"
    reason = reason_of(scene, step.artifact)
    if step.artifact is not PLAN or reason or not scene.crowd_lod.use_shot_plan:
        return reason
    changes = yield from changes_since_plan(read_crowd(scene))
    return reason_in(name_inputs(changes))


def update_steps(scene: bpy.types.Scene, bakes: bool = False) -> tuple[UpdateStep, ...]:
    """Return the steps of the scene in the order of the work.

    bakes: whether to bake a scene that has no bake.
    """
    last = (
        UpdateStep(BAKE, _bake_seconds, bake_frames)
        if bakes or is_bake(scene.crowd_lod.build)
        else UpdateStep(BUILD, lambda _: BUILT, build_live)
    )
    return (
        UpdateStep(CROWD, lambda scene: MEASURED * len(scene.crowd_lod.groups), _populate),
        UpdateStep(LODS, lod_seconds, _make),
        UpdateStep(PLAN, _plan_seconds, plan_of_settings),
        last,
    )


def _plan_seconds(scene: bpy.types.Scene) -> float:
    return plan_seconds(scene, scene_data.frames_of(scene))


def _bake_seconds(scene: bpy.types.Scene) -> float:
    return BUILT + BAKED_FRAME * len(scene_data.frames_of(scene))


def due_steps(scene: bpy.types.Scene) -> dict[str, str]:
    """Return why each step is due, by its label, as far as the sidebar can tell.

    A step that rests on a due one may become due by it.
    """
    known = reasons(scene)
    due = {step.label: known.get(step.artifact.operator, "") for step in update_steps(scene)}
    return {label: reason for label, reason in due.items() if reason}


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
    work = Workload()
    yield from work.take(reading_afresh(scene))
    steps = update_steps(scene, bakes)
    sentences: dict[str, str] = {}
    for k, step in enumerate(steps):
        _check_answered(scene, step, sentences)
        work.announce(sum(later.seconds(scene) for later in steps[k:]))
        if (yield from work.take(_reason(scene, step, bakes))):
            if sentences:
                note(next(reversed(sentences)))
            note_doing(step.artifact.operator)
            try:
                sentences[step.label] = yield from work.take(step.work(scene), step.seconds(scene))
            except FAULTS as fault:
                raise CrowdError(_failed(step.label, sentences, fault)) from fault
            yield from work.take(reading_afresh(scene))
    look_again(scene)
    return sentences


def _check_answered(scene: bpy.types.Scene, step: UpdateStep, done: dict[str, str]) -> None:
    """Raise CrowdError before LOD meshes are made of characters that nobody gave an action."""
    if step.artifact is LODS:
        try:
            check_answered(scene)
        except CrowdError as question:
            raise CrowdError(_failed(step.label, done, question)) from question


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
    """Populate, make LOD meshes, plan the shot, build or bake: what has changed, and nothing else"""

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
        return f"{', '.join(done)}: done. {verdict_in_words(scene.crowd_lod)}".strip()


CLASSES = (CROWDLOD_OT_update_all,)
