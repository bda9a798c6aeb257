"""The order of the work: which button comes next, and what there is to say about it."""

from collections.abc import Iterable
from typing import NamedTuple

import bpy

from ...crowd_lod.messages import Message, MessageKind, from_json
from ...crowd_lod.simplification.decimate import missing_library
from ..blender.callbacks import troubles_of
from ..blender.sidebar_answers import keep_at_work
from ..build.appended_builds import note_on_sets, standing_still
from ..freshness.artifacts import artifacts_of, current_proof, news_of, reasons
from ..scene.characters.motionless import questions
from ..scene.shot_reference import notes_on_file
from ..settings import needs
from ..settings.messages import in_words, label_of
from ..viewport import viewport_overlay


def next_operator(scene: bpy.types.Scene) -> str:
    """Return the operator that comes next in the work; "" once the shot is proved."""
    if scene.crowd_lod.characters is None:
        return "crowd_lod.characters_from_selection"
    return next(iter(reasons(scene)), "")


class Told(NamedTuple):
    """A line of the sidebar; the operator whose button mends what it tells, or ""."""

    sentence: str
    icon: str
    remedy: str = ""


def _warnings(found: Iterable[Message]) -> list[Told]:
    return [Told(line.sentence, "ERROR", line.remedy) for line in in_words(found)]


@keep_at_work
def messages(scene: bpy.types.Scene) -> list[Told]:
    """Return all that the user should know, the most urgent first."""
    settings = scene.crowd_lod
    drawn_frame = viewport_overlay.display_of(scene)
    errors = [
        viewport_overlay.problem(scene),
        missing_library(),
        standing_still(scene),
        note_on_sets(scene),
        *troubles_of(scene),
    ]
    if settings.characters is not None:
        errors.append(needs.camera(scene))
    lines = [Told(sentence, "ERROR") for sentence in dict.fromkeys(errors) if sentence]
    if settings.characters is not None:  # without an answer Update All makes no LOD meshes
        lines += _warnings(questions(scene))
    proof = current_proof(scene)
    told = [] if proof is None else [Told(proof.sentence, "CHECKMARK" if proof.ok else "ERROR")]
    lines += [line for line in told if line.icon == "ERROR"]
    if operator := next_operator(scene):
        reason = reasons(scene).get(operator, "select them first")
        sentence = f"Next: {label_of(operator)}. {reason[0].upper()}{reason[1:]}."
        lines.append(Told(sentence, "FORWARD"))
    for artifact in artifacts_of(scene):
        if news := news_of(scene, artifact):
            lines.append(Told(news, "FILE_REFRESH"))
    lines += told
    # warnings of Populate do not stop the work: the next step is named before them
    if settings.characters is not None:
        found = from_json(settings.trouble)
        lines += _warnings(each for each in found if each.kind is not MessageKind.GLIDES)
    if note := notes_on_file(settings):
        lines.append(Told(note, "INFO"))
    notes = drawn_frame.notes if drawn_frame else ()
    lines += [Told(note, "INFO") for note in notes]
    first: dict[str, Told] = {}
    for line in lines:
        first.setdefault(line.sentence, line)
    return list(first.values())
