"""Our entries in Blender's menus, where F3 finds them, and the operator of sample scenes."""

import bpy

from ... import sample_scenes
from ..blender.labeled_properties import CONTEXT, EnumProperty
from ..blender.operator import Reporting
from .agent_overrides import BUTTONS


class CROWDLOD_OT_sample(Reporting, bpy.types.Operator):
    """Add a sample scene to this file, beside your own scene, and show it"""

    bl_idname = "crowd_lod.sample"
    bl_label = "Sample Scene"

    name: EnumProperty(name="Sample", items=[(n, n.capitalize(), "") for n in sample_scenes.NAMES])

    def run(self, context) -> str:
        scene = bpy.data.scenes.new(self.name.capitalize())
        sample_scenes.make(self.name, scene)
        context.window.scene = scene
        return f"The scene {scene.name} was added; your own scene is in the scene selector."


WORK = (
    "characters_from_selection",
    "populate",
    "make_slot",
    "mark_as_prop",
    "give_lod",
    "take_action",
    "take_along",
    "simulate",
    "make_levels",
    "inspect",
    "render_viewport",
    "plan_shot",
    "go_to_switch",
    "erase",
    "find_agents",
    "preview",
    "estimate",
    "build",
    "bake",
    "remove_build",
    "export_usd",
    "write_farm_job",
    "verify",
    "show_proof",
    "report_error",
    "reset",
)


class CROWDLOD_MT_work(bpy.types.Menu):
    """All steps of the work; Menu Search finds them by the name of this menu"""

    bl_label = "Crowd LOD"
    bl_translation_context = CONTEXT

    def draw(self, context) -> None:
        for name in WORK:
            self.layout.operator(f"crowd_lod.{name}")
        for type_, (text, icon) in BUTTONS.items():
            self.layout.operator(
                "crowd_lod.override_agent", text=f"{text} Picked Agent", icon=icon, translate=False
            ).type = type_


class CROWDLOD_MT_samples(bpy.types.Menu):
    """Sample scenes, each in a scene of its own"""

    bl_label = "Crowd LOD Sample"
    bl_translation_context = CONTEXT

    def draw(self, context) -> None:
        for name in sample_scenes.NAMES:
            self.layout.operator(
                "crowd_lod.sample", text=f"{name.capitalize()} (New Scene)", translate=False
            ).name = name


def _in_object_menu(menu, context) -> None:
    menu.layout.separator()
    menu.layout.menu("CROWDLOD_MT_work", icon="COMMUNITY")


def _in_add_menu(menu, context) -> None:
    menu.layout.separator()
    menu.layout.menu("CROWDLOD_MT_samples", icon="COMMUNITY")


ENTRIES = (("VIEW3D_MT_object", _in_object_menu), ("VIEW3D_MT_add", _in_add_menu))


def register() -> None:
    for name, entry in ENTRIES:
        getattr(bpy.types, name).append(entry)


def unregister() -> None:
    for name, entry in ENTRIES:
        getattr(bpy.types, name).remove(entry)


CLASSES = (
    CROWDLOD_OT_sample,
    CROWDLOD_MT_work,
    CROWDLOD_MT_samples,
)
