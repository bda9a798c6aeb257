"""The table of artifacts, and the one answer to whether one is out of date.

docs/notes/freshness.md has the table of artifacts and parts.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender import provenance, scene_cache, scene_data
from ..blender.provenance import text_digest
from ..blender.sidebar_answers import hold, keep_at_work
from ..blender.stored_values import contents_of
from ..scene.characters.character_provenance import CHARACTER, MOTION, is_known
from ..scene.scene_crowd import read_crowd
from ..scene.shot_reference import CAMERA, reference, stored_plan
from ..scene.sources.crowd_parts import GROUPS, SPEEDS, crowd_made_of, crowd_parts
from ..scene.sources.crowd_sources import live
from ..settings.stored_figures import NO_BUDGET, holds_anyway
from .bake_frames import differing_now, is_bake
from .parts import (
    BUDGET,
    FOLLOWED,
    MEMORY,
    SIMPLIFY,
    WORDED,
    build_parts,
    camera_motion,
    lacking_lods,
    lod_parts,
    plan_parts,
)

Parts = Mapping[str, str]


class ProofResult(NamedTuple):
    """What the last proof of a scene found.

    sentence: its verdict; ok: whether the pictures are the same; made_of: the parts proved; worst:
    of verify.json the agent that is farthest off, None if none is.
    """

    sentence: str
    ok: bool
    made_of: Parts
    worst: Mapping[str, Any] | None = None


_proofs: dict[int, ProofResult] = scene_cache.add_cache({}, by_scene=True)


class Change(NamedTuple):
    """A part that differs from what an artifact was made of: its name, what it was, and is."""

    part: str
    before: str
    now: str

    def __str__(self) -> str:
        if self.part == GROUPS:
            went = f"removed {self.before}" * bool(self.before)
            came = f"added {self.now}" * bool(self.now)
            return f"{self.part} ({', '.join(filter(None, [came, went]))})"
        was = f"{self.part} (was {self.before}, now {self.now})"
        return was if self.part in WORDED else self.part


class Artifact(NamedTuple):
    """What a step makes.

    operator: makes it anew.
    label: on its button.
    lacking: why the step is due where there is none; "" where it is not.
    made_of: scene -> the parts that it was made of; None if there is none, or it does not say.
    parts: scene -> those that there are now.
    settle: (scene, made_of, parts) -> the changes between them that count.
    """

    operator: str
    label: str
    lacking: Callable[[bpy.types.Scene], str]
    made_of: Callable[[bpy.types.Scene], Parts | None]
    parts: Callable[[bpy.types.Scene], Parts]
    settle: Callable[[bpy.types.Scene, Parts, Parts], list[Change]]


def changes_of(scene: bpy.types.Scene, artifact: Artifact) -> list[Change]:
    """Return the parts that differ from what the scene's artifact was made of; none without one.

    CrowdError if the crowd's settings are bad.
    """
    try:
        made_of = artifact.made_of(scene)
    except CrowdError as error:  # its file is gone, or spoilt
        return [Change(str(error).rstrip("."), "", "")]
    return [] if made_of is None else artifact.settle(scene, made_of, artifact.parts(scene))


def reason_of(scene: bpy.types.Scene, artifact: Artifact) -> str:
    """Return why the artifact is to be made: that there is none, or what has changed; "" if it is
    up to date.
    """
    return artifact.lacking(scene) or reason_in(words_of(changes_of(scene, artifact)))


def reason_in(names: str) -> str:
    """Return the reason that lies in changes of these names; "" without."""
    return f"{names} changed" if names else ""


def words_of(changes: Sequence[Change]) -> str:
    """Return the changes in words, such as "the camera and LOD 1 of adult"; "" if none."""
    return provenance.name_inputs(list(map(str, changes)))


def stale(scene: bpy.types.Scene, artifact: Artifact) -> list[Change]:
    """Return what `changes_of` does, as of a look a second ago at most.

    While a step is at work, as of its begin. It costs nothing, so that drawings ask it.
    """
    _, changes = _answers(scene).get(artifact.operator, ("", []))
    return changes


def news_of(scene: bpy.types.Scene, artifact: Artifact) -> str:
    """Return a line on what `stale` tells; "" if the artifact is up to date."""
    names = words_of(stale(scene, artifact))
    return f"Changed since {artifact.label}: {names}" if names else ""


def reasons(scene: bpy.types.Scene) -> dict[str, str]:
    """Return why each artifact is due, by its operator, as of a look a second ago at most."""
    said = {
        operator: lacking or reason_in(words_of(changes))
        for operator, (lacking, changes) in _answers(scene).items()
    }
    return {operator: reason for operator, reason in said.items() if reason}


def look_again(scene: bpy.types.Scene) -> None:
    """Let the next drawing look at once."""
    _looks.drop(scene)


@keep_at_work
def _answers(scene: bpy.types.Scene) -> dict[str, tuple[str, list[Change]]]:
    known = _looks.latest(scene)
    return known if known is not None and not is_known(scene) else _looks(scene)


def _quick(scene: bpy.types.Scene) -> tuple:
    """Return what tells most changes at once, for the answer of the last second."""
    settings = scene.crowd_lod
    top = settings.characters
    names = () if top is None else (*top.children.keys(), *top.objects.keys())
    there = [block and block.session_uid for block in (settings.levels, settings.build)]
    return provenance.changes, reference(settings), *there, names, contents_of(settings)


@hold(_quick)
def _looks(scene: bpy.types.Scene) -> dict[str, tuple[str, list[Change]]]:
    answers = {}
    for artifact in artifacts_of(scene):
        changes: list[Change] = []
        with suppress(CrowdError):  # what is wrong with the crowd is told elsewhere
            changes = changes_of(scene, artifact)
        answers[artifact.operator] = artifact.lacking(scene), changes
    return answers


def note_lods(scene: bpy.types.Scene, parts: Parts) -> None:
    """Keep with the scene's LOD meshes what they were made of: lod_parts, as the work began."""
    provenance.keep(scene.crowd_lod.levels, parts)
    look_again(scene)


def note_build(scene: bpy.types.Scene, parts: Parts) -> None:
    """Keep with the scene's build what it was made of: build_parts, as the work began."""
    build = scene.crowd_lod.build
    followed = () if is_bake(build) else FOLLOWED
    own = {name: part for name, part in parts.items() if name not in followed}
    provenance.keep(build, own)
    look_again(scene)


def note_proof(scene: bpy.types.Scene, proof: ProofResult) -> None:
    """Keep the scene's last proof, as long as the file is open."""
    scene_cache.tidy()
    _proofs[scene.session_uid] = proof
    look_again(scene)


def current_proof(scene: bpy.types.Scene) -> ProofResult | None:
    """Return what the last proof of the scene found; None if there is none, or it is `stale`."""
    proof = _proofs.get(scene.session_uid)
    return None if proof is None or stale(scene, PROOF) else proof


def _differ(_, made_of: Parts, parts: Parts) -> list[Change]:
    names = provenance.differences(made_of, parts)
    return [Change(name, made_of.get(name, ""), parts.get(name, "")) for name in names]


# The crowd


def _no_crowd(scene: bpy.types.Scene) -> str:
    settings = scene.crowd_lod
    return "" if len(settings.groups) and len(settings.crowds) else "there is no crowd"


def _crowd_made_of(scene: bpy.types.Scene) -> Parts | None:
    return None if _no_crowd(scene) else crowd_made_of(scene)


def _settle_crowd(scene: bpy.types.Scene, made_of: Parts, parts: Parts) -> list[Change]:
    """Return the changes, with the groups that went and came; these tell of their motions.

    By the agents' speeds actions are judged that travel, and nothing else.
    """
    changes = []
    groups = scene.crowd_lod.groups
    travels = any(each.way for group in groups for each in (group, *group.actions))
    for change in _differ(scene, made_of, parts):
        if change.part == GROUPS:
            before = change.before.splitlines()
            now = change.now.splitlines()
            went = ", ".join(line for line in before if line not in now)
            came = ", ".join(line for line in now if line not in before)
            changes.append(Change(GROUPS, went, came))
        elif change.part == SPEEDS:
            changes += [change] * travels
        elif not change.part.startswith(MOTION) or (change.before and change.now):
            changes.append(change)
    return changes


# LOD meshes


def _no_lods(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.levels is not None else "there are no LOD meshes"


def _lods_made_of(scene: bpy.types.Scene) -> Parts | None:
    levels = scene.crowd_lod.levels
    return None if levels is None else provenance.read_inputs(levels)


def _settle_lods(scene: bpy.types.Scene, made_of: Parts, parts: Parts) -> list[Change]:
    """Return what is missing, and the changes of what both name: LODs by distance do not say for
    which view they are.
    """
    changes = [Change(*lack) for lack in lacking_lods(scene)]
    differing = _differ(scene, made_of, parts)
    changes += [change for change in differing if change.before and change.now]
    if made_of.get(BUDGET) == NO_BUDGET and holds_anyway(scene.crowd_lod):
        return [change for change in changes if change.part != BUDGET]  # they would be the same
    return changes


# Shot plans


def _no_plan(scene: bpy.types.Scene) -> str:
    """Return that there is no plan, but for a build by distance, which the user chose."""
    settings = scene.crowd_lod
    by_distance = settings.build is not None or live(settings)
    return "" if settings.shot_plan or by_distance else "there is no plan"


def _plan_made_of(scene: bpy.types.Scene) -> Parts | None:
    settings = scene.crowd_lod
    stored = stored_plan(settings) if settings.levels is not None else None
    return stored and stored.made_of


# Builds and bakes


def _no_build(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.build is not None else "there is no build"


def _build_made_of(scene: bpy.types.Scene) -> Parts | None:
    build = scene.crowd_lod.build
    return build and (provenance.read_inputs(build) or None)


def _bake_parts(scene: bpy.types.Scene) -> Parts:
    return build_parts(read_crowd(scene))


def _live_build_parts(scene: bpy.types.Scene) -> Parts:
    return {name: part for name, part in _bake_parts(scene).items() if name not in FOLLOWED}


def _settle_bake(scene: bpy.types.Scene, made_of: Parts, parts: Parts) -> list[Change]:
    changes = _differ(scene, made_of, parts)
    names = [change.part for change in changes]
    in_frame = differing_now(scene, scene.crowd_lod.build)
    return [*changes, *(Change(name, "", "") for name in in_frame if name not in names)]


# Proofs


def _no_proof(scene: bpy.types.Scene) -> str:
    proof = _proofs.get(scene.session_uid)
    if proof is None:
        return "the shot is not verified yet"
    return "" if proof.ok else "the last proof failed"


def proof_parts(scene: bpy.types.Scene) -> Parts:
    """Return what a proof is of: the build, and what its frames show of it."""
    build = scene.crowd_lod.build
    return {
        "the build": text_digest(build and build.get(provenance.MADE_OF)),
        CAMERA: camera_motion(scene),
        "the frames": text_digest(list(scene_data.frames_of(scene))),
    }


def _proof_made_of(scene: bpy.types.Scene) -> Parts | None:
    proof = _proofs.get(scene.session_uid)
    return proof and proof.made_of


CROWD = Artifact(
    "crowd_lod.populate", "Populate", _no_crowd, _crowd_made_of, crowd_parts, _settle_crowd
)
LODS = Artifact(
    "crowd_lod.make_levels",
    "Make LOD Meshes",
    _no_lods,
    _lods_made_of,
    lod_parts,
    _settle_lods,
)
PLAN = Artifact("crowd_lod.plan_shot", "Plan Shot", _no_plan, _plan_made_of, plan_parts, _differ)
BUILD = Artifact("crowd_lod.build", "Build", _no_build, _build_made_of, _live_build_parts, _differ)
BAKE = Artifact("crowd_lod.bake", "Bake", _no_build, _build_made_of, _bake_parts, _settle_bake)
PROOF = Artifact("crowd_lod.verify", "Verify", _no_proof, _proof_made_of, proof_parts, _differ)


def build_artifact(scene: bpy.types.Scene) -> Artifact:
    """Return BAKE if the scene's build is a bake, else BUILD."""
    return BAKE if is_bake(scene.crowd_lod.build) else BUILD


def artifacts_of(scene: bpy.types.Scene) -> tuple[Artifact, ...]:
    """Return the artifacts of the scene in the order of the work."""
    return CROWD, LODS, PLAN, build_artifact(scene), PROOF


def to_make_again(scene: bpy.types.Scene) -> str:
    """Return a sentence if LOD meshes show other characters than there are now, or are for another
    memory; "" if not.
    """
    changes = [
        change
        for change in changes_of(scene, LODS)
        if change.part in (MEMORY, SIMPLIFY) or change.part.startswith(CHARACTER)
    ]
    if not changes:
        return ""
    names = provenance.name_inputs([change.part for change in changes])
    return (
        f"Since the LOD meshes were made, {names} changed: press Make LOD Meshes, and Build again."
    )
