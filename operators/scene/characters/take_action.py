"""Take Action: characters that glide or nod get an action of the file that walks."""

from collections.abc import Iterator

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.messages import Message, MessageKind
from ...blender.animation import armatures_of
from ...blender.labeled_properties import StringProperty
from ...blender.named_actions import own_performance
from ...blender.operator import Reporting
from ...settings import needs
from ...settings.crowds import crowds_of
from ..machine.scene_world import machine_of
from .action_choice import Fit, best, choose_action, is_called_a_walk, take, walk_among
from .characters import all_characters


def motionless(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Return the character groups of `scene` whose rig plays nothing, and the rig."""
    rigs_at_rest = {}
    for name, objects, _, variant_of, *_ in all_characters(scene):
        rigs = armatures_of(objects)
        if rigs and not variant_of and own_performance(objects).still:
            rigs_at_rest[name] = rigs[0]
    return rigs_at_rest


def gliding(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Return those of `motionless` whose agents walk by an animation of their own, and the rig."""
    return motionless(scene) if _somebody_walks(scene) else {}


def _somebody_walks(scene: bpy.types.Scene) -> bool:
    crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if crowd.use_crowd]
    return any(crowd.source != "MACHINE" or _walks(crowd) for crowd in crowds)


def nodding(scene: bpy.types.Scene) -> dict[str, tuple[bpy.types.Object, Fit]]:
    """Return the groups of `scene` that play another of their file's actions than its walk.

    With each its rig, and the walk.
    """
    walks = {}
    for name, objects, _, variant_of, *_ in all_characters(scene):
        for rig in armatures_of(objects)[:1]:
            if not variant_of and (fit := walk_among(scene, rig, objects)) is not None:
                walks[name] = rig, fit
    return walks


def _walks(crowd: bpy.types.PropertyGroup) -> bool:
    machine = machine_of(crowd)
    return any(not name and machine.velocity[s].any() for s, name in enumerate(machine.actions))


def notes_on_gliding(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters that nod, or glide in their bind pose, with the way out."""
    remedy = CROWDLOD_OT_take_action.bl_idname
    walks = nodding(scene) if _somebody_walks(scene) else {}
    for name, (rig, fit) in walks.items():
        facts = {
            "action": rig.animation_data.action.name,
            "walk": fit.action.name,
            "by_name": is_called_a_walk(fit.action),
        }
        yield Message(MessageKind.NO_WALK, name, facts, remedy)
    for name, rig in gliding(scene).items():
        fit = best(rig, [])
        yield Message(
            MessageKind.GLIDES, name, {"fit": "" if fit is None else fit.action.name}, remedy
        )


class CROWDLOD_OT_take_action(Reporting, bpy.types.Operator):
    """Give characters whose rig plays nothing an action of the file whose bones are theirs"""

    bl_idname = "crowd_lod.take_action"
    bl_label = "Take Action"
    needs = (needs.characters,)

    group: StringProperty(
        name="Group", description="The character group; empty for all whose rig plays nothing"
    )
    action: StringProperty(
        name="Action", description="The action; empty for the one that fits best"
    )

    def run(self, context) -> str:
        scene = context.scene
        walks = nodding(scene)
        rigs = motionless(scene) | {name: rig for name, (rig, _) in walks.items()}
        if self.group and self.group not in rigs:
            raise CrowdError(
                f"The character group {self.group} has an action, or no rig: there is nothing to "
                f"give it."
            )
        rigs_to_move = {self.group: rigs[self.group]} if self.group else rigs
        if not rigs_to_move:
            raise CrowdError("All characters with a rig have an action.")
        fits = {
            name: walks[name][1]
            if name in walks and not self.action
            else choose_action(rig, name, self.action)
            for name, rig in rigs_to_move.items()
        }
        plays = [f"{name} plays {take(rigs_to_move[name], fit).name}" for name, fit in fits.items()]
        return f"{', '.join(plays)} now: press Populate."


CLASSES = (CROWDLOD_OT_take_action,)
