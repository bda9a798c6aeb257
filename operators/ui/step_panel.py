"""What the panels of the sidebar have in common."""

import bpy

from ..blender.labeled_properties import CONTEXT
from . import steps
from .drawing import button


class Sidebar:
    """A panel in the tab of Crowd LOD."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Crowd LOD"
    bl_translation_context = CONTEXT


class StepPanel(Sidebar):
    """A closed panel, which `body(context, layout, settings)` draws."""

    bl_options = {"DEFAULT_CLOSED"}

    def main(self, scene: bpy.types.Scene) -> tuple[str, ...]:
        """Return (operator, text) of the button in the panel's header; () for none."""
        return ()

    def draw_header_preset(self, context) -> None:
        scene = context.scene
        if main := self.main(scene):
            button(self.layout, *main, following=steps.next_operator(scene))

    def draw(self, context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        self.body(context, layout, context.scene.crowd_lod)
