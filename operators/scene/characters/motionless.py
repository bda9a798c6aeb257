"""Characters whose rig plays nothing, and whether somebody has said that they stand still."""

from collections.abc import Iterator

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.message_words import listed
from ....crowd_lod.messages import Message, MessageKind
from ...blender import provenance
from ...blender.action_fit import Fit
from ...blender.animation import action_range, armatures_of
from ...blender.sidebar_answers import hold
from ...blender.time_movers import time_movers
from ...settings.crowds import crowds_of
from ..machine.scene_world import machine_of
from .action_choice import best_walk, fits_of, is_called_a_walk, walk_among
from .characters import all_characters

# custom property of a group's collection or object: it has no action, and is to have none
STANDS_STILL = "stands_still"


def owner_of(scene: bpy.types.Scene, group: str) -> bpy.types.Collection | bpy.types.Object:
    """Return the collection or the object that is a character group."""
    top = scene.crowd_lod.characters
    return top.children.get(group) or top.objects[group]


def rig_of(scene: bpy.types.Scene, group: str) -> bpy.types.Object | None:
    """Return the rig that moves a character group, None without; it costs little."""
    owner = owner_of(scene, group)
    is_home = isinstance(owner, bpy.types.Collection)
    items = list(owner.all_objects) if is_home else [owner, *owner.children_recursive]
    return next(iter(armatures_of(items)), None)


def motionless(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Return the character groups of `scene` whose rig plays nothing, and the rig."""
    rigs_at_rest = {}
    for name, objects, _, variant_of, *_ in all_characters(scene):
        rigs = armatures_of(objects)
        first, last = action_range(objects)
        if rigs and not variant_of and first == last:
            rigs_at_rest[name] = rigs[0]
    return rigs_at_rest


def unanswered(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Return those of `motionless` whose agents play their own animation, and the rig.

    Those are left out of which somebody has said that they stand still, or whom somebody has posed
    in a crowd where nobody walks.
    """
    crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if crowd.use_crowd]
    walk = any(crowd.source != "MACHINE" or _walks(crowd) for crowd in crowds)
    if not walk and all(all(machine_of(crowd).actions) for crowd in crowds):
        return {}
    return {
        name: rig
        for name, rig in motionless(scene).items()
        if not owner_of(scene, name).get(STANDS_STILL) and (walk or not _is_posed(rig))
    }


def _walks(crowd: bpy.types.PropertyGroup) -> bool:
    machine = machine_of(crowd)
    return any(not name and machine.velocity[s].any() for s, name in enumerate(machine.actions))


def _is_posed(rig: bpy.types.Object) -> bool:
    return any(not bone.matrix_basis.is_identity for bone in rig.pose.bones)


def nodding(scene: bpy.types.Scene) -> dict[str, tuple[bpy.types.Object, Fit]]:
    """Return the groups that walk by another of their file's actions than its walk.

    With each its rig, and the walk.
    """
    crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if crowd.use_crowd]
    if not any(crowd.source != "MACHINE" or _walks(crowd) for crowd in crowds):
        return {}
    walks = {}
    for name, objects, _, variant_of, *_ in all_characters(scene):
        for rig in armatures_of(objects)[:1]:
            if not variant_of and (fit := walk_among(scene, rig, objects)) is not None:
                walks[name] = rig, fit
    return walks


REMEDY = "crowd_lod.take_action"


def notes_on_nodding(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters that walk by another action than their walk."""
    for name, (rig, fit) in nodding(scene).items():
        facts = {
            "action": rig.animation_data.action.name,
            "walk": fit.action.name,
            "by_name": is_called_a_walk(fit.action),
        }
        yield Message(MessageKind.NO_WALK, name, facts, REMEDY)


def notes_on_gliding(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters that stay in their bind pose, with the way out."""
    for name, rig in unanswered(scene).items():
        walk = best_walk(rig)
        fits = fits_of(rig)
        facts = {
            "walk": "" if walk is None else walk.action.name,
            "others": [fit.action.name for fit in fits if not fit.misfits],
            "refused": [fit.action.name for fit in fits if fit.misfits],
            "movers": time_movers([rig]),
        }
        yield Message(MessageKind.GLIDES, name, facts, REMEDY)


def notes_on_time(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters without a rig that the scene's time moves, and no action."""
    for name, objects, _, variant_of, *_ in all_characters(scene):
        first, last = action_range(objects)
        if not variant_of and first == last and not armatures_of(objects):
            if movers := time_movers(objects):
                yield Message(MessageKind.BY_TIME, name, {"movers": listed(movers)})


@hold(lambda _: provenance.changes)
def questions(scene: bpy.types.Scene) -> tuple[Message, ...]:
    """Return `notes_on_gliding` for drawings; none where the crowd's settings are bad."""
    try:
        return tuple(notes_on_gliding(scene))
    except CrowdError:  # told elsewhere
        return ()


def check_answered(scene: bpy.types.Scene) -> None:
    """Raise CrowdError, a question, if a character would stay in its bind pose unasked."""
    names = list(unanswered(scene))
    if names:
        have, one = ("has", "one") if len(names) == 1 else ("have", "theirs")
        raise CrowdError(
            f"{listed(names)} {have} no action: choose {one} in Character Groups, or press Stand "
            f"Still."
        )
