"""The menu of state machines that come with Crowd LOD."""

import bpy

from ...crowd_lod.crowd.state_machine import load_preset, preset_names
from ..blender.labeled_properties import CONTEXT, EnumProperty
from ..blender.operator import Reporting
from ..settings.crowds import active_or_new


class CROWDLOD_OT_machine_preset(Reporting, bpy.types.Operator):
    """Load this state machine into a text block of its own, for the active crowd"""

    bl_idname = "crowd_lod.machine_preset"
    bl_label = "State Machine Preset"

    name: EnumProperty(name="Preset", items=[(n, n.capitalize(), "") for n in preset_names()])

    def run(self, context) -> str:
        machine = load_preset(self.name)
        text = bpy.data.texts.new(f"{self.name}.json")
        text.from_string(machine.text)
        active_or_new(context.scene.crowd_lod).machine = text
        return (
            f"{text.name}: {len(machine.states)} states; its labels are "
            f"{', '.join(machine.labels)}."
        )


class CROWDLOD_MT_machine_presets(bpy.types.Menu):
    bl_label = "Presets"
    bl_translation_context = CONTEXT

    def draw(self, context) -> None:
        for name in preset_names():
            self.layout.operator(
                "crowd_lod.machine_preset", text=name.capitalize(), translate=False
            ).name = name
        self.layout.separator()
        self.layout.operator("crowd_lod.machine_import", icon="IMPORT")
        self.layout.operator("crowd_lod.machine_export", icon="EXPORT")


CLASSES = (CROWDLOD_OT_machine_preset, CROWDLOD_MT_machine_presets)
