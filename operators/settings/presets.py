"""Presets of the settings in Blender's own menu, and Reset to Defaults.

Both are of the scene's settings and those of its active crowd.

A preset holds numbers and choices. Data-blocks, paths and what steps have made are not in it.
"""

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ...crowd_lod.format import counted
from ..blender.labeled_properties import CONTEXT
from ..blender.operator import Reporting
from .crowd_settings import CROWD_NAMES
from .crowds import active_crowd
from .level_settings import note_thresholds
from .properties import ALL, property_of
from .setting_changes import outdate

# what the user looks at now, and what a step found: no preset holds them
PASSING = {"overlay", "agent", "override_index", "use_shot_plan", "use_crowd", "points_count"}


def setting_names() -> list[str]:
    """Return the names of the settings that a preset holds, of the scene and of a crowd."""
    return [
        name
        for part in ALL
        for name in part.__annotations__
        if name not in PASSING and property_of(name).type in ("BOOLEAN", "INT", "FLOAT", "ENUM")
    ]


class CROWDLOD_OT_reset(Reporting, bpy.types.Operator):
    """Reset these settings, and those of the active crowd, to their defaults; data-blocks stay"""

    bl_idname = "crowd_lod.reset"
    bl_label = "Reset to Defaults"

    def run(self, context) -> str:
        names = setting_names()
        settings = context.scene.crowd_lod
        crowd = active_crowd(settings)
        for name in names:
            owner = crowd if name in CROWD_NAMES else settings
            if owner is not None:
                owner.property_unset(name)
        # property_unset calls no update callback
        note_thresholds(settings)
        outdate(settings, context)
        return (
            f"{counted(len(names), 'setting is at its default', 'settings are at their defaults')}."
        )


class CROWDLOD_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of these settings and those of the active crowd"""

    bl_idname = "crowd_lod.preset_add"
    bl_label = "Add Preset"
    bl_options = {"REGISTER", "INTERNAL"}
    bl_translation_context = CONTEXT
    preset_menu = "CROWDLOD_PT_presets"
    preset_subdir = "crowd_lod"
    preset_defines = ["settings = bpy.context.scene.crowd_lod", "crowd = settings.active_crowd"]

    def pre_cb(self, context) -> None:
        # known once the settings are registered
        type(self).preset_values = [
            f"{'crowd' if name in CROWD_NAMES else 'settings'}.{name}" for name in setting_names()
        ]


class CROWDLOD_PT_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Presets"
    bl_translation_context = CONTEXT
    preset_subdir = "crowd_lod"
    preset_operator = "script.execute_preset"
    preset_add_operator = "crowd_lod.preset_add"

    def draw(self, context) -> None:
        super().draw(context)
        self.layout.operator("crowd_lod.reset", icon="LOOP_BACK")


CLASSES = CROWDLOD_OT_reset, CROWDLOD_PT_presets, CROWDLOD_OT_preset_add
