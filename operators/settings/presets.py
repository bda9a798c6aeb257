"""Presets of each step's settings in Blender's own menus, and Reset to Defaults.

A preset holds numbers and choices. Data-blocks, paths and what steps have made are not in it.
"""

from typing import Any

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ...crowd_lod.format import counted
from ..blender.labeled_properties import CONTEXT, EnumProperty
from ..blender.operator import Reporting
from .outdated_estimate import outdate
from .properties import ALL, STEPS, CrowdLodSettings
from .threshold_order import note_thresholds

PARTS = STEPS | {"all": ALL}
# settings that say what the user looks at now: no preset holds them
PASSING = {"overlay", "agent", "exception_index", "use_shot_plan"}


def names_of(step: str) -> list[str]:
    """Return the names of the settings that a preset of the step holds."""
    kinds: Any = CrowdLodSettings.bl_rna.properties
    return [
        name
        for part in PARTS[step]
        for name in part.__annotations__
        if name not in PASSING and kinds[name].type in ("BOOLEAN", "INT", "FLOAT", "ENUM")
    ]


class CROWDLOD_OT_reset(Reporting, bpy.types.Operator):
    """Reset these settings to their defaults; data-blocks stay"""

    bl_idname = "crowd_lod.reset"
    bl_label = "Reset to Defaults"

    step: EnumProperty(
        name="Step", items=[(step, step.capitalize(), "") for step in PARTS], default="all"
    )

    def run(self, context) -> str:
        names = names_of(self.step)
        settings = context.scene.crowd_lod
        for name in names:
            settings.property_unset(name)
        # property_unset calls no update callback
        note_thresholds(settings)
        outdate(settings, context)
        return (
            f"{counted(len(names), 'setting is at its default', 'settings are at their defaults')}."
        )


class _Adding(AddPresetBase):
    """Add or remove a preset of these settings"""

    preset_defines = ["settings = bpy.context.scene.crowd_lod"]
    bl_options = {"REGISTER", "INTERNAL"}
    bl_translation_context = CONTEXT

    def pre_cb(self, context) -> None:
        # known once the settings are registered
        type(self).preset_values = [f"settings.{name}" for name in names_of(self.step)]


class _Presets(PresetPanel):
    preset_operator = "script.execute_preset"
    bl_translation_context = CONTEXT

    def draw(self, context) -> None:
        super().draw(context)
        self.layout.operator("crowd_lod.reset", icon="LOOP_BACK").step = self.step


def _classes(step: str) -> tuple[type, type]:
    """Return the panel of the step's presets, and the operator that adds one."""
    shared = {"step": step, "preset_subdir": f"crowd_lod/{step}", "__doc__": _Adding.__doc__}
    panel = f"CROWDLOD_PT_{step}_presets"
    adding = f"crowd_lod.{step}_preset_add"
    return (
        type(
            panel,
            (_Presets, bpy.types.Panel),
            {**shared, "bl_label": f"{step.capitalize()} Presets", "preset_add_operator": adding},
        ),
        type(
            f"CROWDLOD_OT_{step}_preset_add",
            (_Adding, bpy.types.Operator),
            {
                **shared,
                "bl_idname": adding,
                "bl_label": f"Add {step.capitalize()} Preset",
                "preset_menu": panel,
            },
        ),
    )


CLASSES = (CROWDLOD_OT_reset, *(kind for step in PARTS for kind in _classes(step)))
