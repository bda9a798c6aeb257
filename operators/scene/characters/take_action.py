"""Take Action: what characters whose rig plays nothing are to do, or that they stand still."""

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.message_words import listed
from ...blender.labeled_properties import BoolProperty, StringProperty
from ...blender.operator import Reporting
from ...settings import needs
from .action_choice import choose_action, take
from .characters import all_characters
from .motionless import STANDS_STILL, motionless, nodding, owner_of, questions, rig_of


class CROWDLOD_OT_take_action(Reporting, bpy.types.Operator):
    """Give rigs without an action the walk in the file that fits their bones"""

    bl_idname = "crowd_lod.take_action"
    bl_label = "Take Action"
    needs = (needs.characters,)

    group: StringProperty(
        name="Group", description="The character group; empty for all without an action"
    )
    action: StringProperty(
        name="Action", description="The action; empty for the walk that fits best"
    )
    still: BoolProperty(
        name="Stand Still",
        description="Let rigs without an action stand still",
    )

    @classmethod
    def description(cls, context, properties) -> str:
        return properties.bl_rna.properties["still"].description if properties.still else ""

    def run(self, context) -> str:
        scene = context.scene
        if self.still:
            return _stand_still(scene, self.group)
        walks = nodding(scene)
        rigs = motionless(scene) | {name: rig for name, (rig, _) in walks.items()}
        if self.group:
            rigs = {self.group: _rig_of_group(scene, self.group)}
        if not rigs:
            raise CrowdError("Nothing to do: all rigs play an action.")
        plays: list[str] = []
        refused: list[str] = []
        for name, rig in rigs.items():
            try:
                is_known = name in walks and not self.action
                fit = walks[name][1] if is_known else choose_action(rig, name, self.action)
            except CrowdError as error:
                refused.append(str(error))
                continue
            turned = f" (keys turned over: {listed(fit.turned)})" if fit.turned else ""
            plays.append(f"{name} plays {take(rig, fit).name}{turned}")
        if not plays:
            raise CrowdError(" ".join(dict.fromkeys(refused)))
        return " ".join([f"{', '.join(plays)} now: press Populate.", *dict.fromkeys(refused)])


def _rig_of_group(scene: bpy.types.Scene, group: str) -> bpy.types.Object:
    names = [each.name for each in all_characters(scene) if not each.variant_of]
    rig = rig_of(scene, group) if group in names else None
    if rig is None:
        raise CrowdError(
            f"The character group {group} has no rig: only rigs play actions, so parent its "
            "meshes to one."
        )
    return rig


def _stand_still(scene: bpy.types.Scene, group: str) -> str:
    """Let the group's rig, or all that play nothing, stand still; return a sentence."""
    names = [name for name in motionless(scene) if group in ("", name)]
    if not names:
        raise CrowdError("Nothing to do: all rigs play an action.")
    for name in names:
        owner_of(scene, name)[STANDS_STILL] = True
    questions.drop(scene)  # Blender reports no such change
    verb = "stands" if len(names) == 1 else "stand"
    return f"{listed(names)} now {verb} still in the crowd, without an action."


CLASSES = (CROWDLOD_OT_take_action,)
