"""What the panels of the sidebar have in common."""

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
    """The panel of one step of the work; `body(context, layout, settings)` draws it.

    main: (operator, text) of the button in the panel's header; () for none.
    """

    bl_parent_id = "CROWDLOD_PT_main"
    bl_options = {"DEFAULT_CLOSED"}
    main: tuple[str, ...] = ()

    def draw_header_preset(self, context) -> None:
        if self.main:
            button(self.layout, *self.main, following=steps.next_operator(context.scene))
        self.draw_help()

    def draw_help(self) -> None:
        """Draw, in a step's header, the button that shows the manual's part on it."""
        if self.bl_parent_id == StepPanel.bl_parent_id:
            help_button(self.layout, self.bl_label)

    def draw(self, context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        self.body(context, layout, context.scene.crowd_lod)


def help_button(layout, part: str) -> None:
    """Draw the button that shows the manual's part of this heading."""
    layout.operator("crowd_lod.help", text="", icon="HELP", emboss=False).part = part
