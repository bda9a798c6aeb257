"""The crowds of a scene: their list in the sidebar."""

import bpy

from ...crowd_lod.sources.trajectory import Trajectory
from ..settings.crowds import active_crowd, add_crowd, index_of_active, set_lengths
from ..viewport import viewport_overlay
from .settings_list import SettingsList
from .step_panel import StepPanel


class CROWDLOD_UL_crowds(bpy.types.UIList):
    """One crowd a row: whether it is there, its name and its size."""

    def draw_item(  # noqa: PLR0913 - Blender's own signature
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "name", text="", emboss=False)
        row.prop(
            item,
            "use_crowd",
            text="",
            icon="HIDE_OFF" if item.use_crowd else "HIDE_ON",
            emboss=False,
        )


def _add(context) -> str:
    settings = context.scene.crowd_lod
    set_lengths(context.scene)
    before = active_crowd(settings)
    ground = None if before is None else ((*before.center,), (*before.size,))
    crowd = add_crowd(settings)
    if ground is not None:
        crowd.center, crowd.size = ground
        crowd.count = 100
        crowd.seed = len(settings.crowds)
    settings.crowd_index = len(settings.crowds) - 1
    return f"Added {crowd.name}: choose its source and place."


CROWDS = SettingsList(
    "crowd",
    {
        "add": "Add a crowd with settings of its own: one plan covers all crowds",
        "remove": "Remove the active crowd; the agents of crowds after it get other numbers",
        "move": "Move the active crowd; agents get other numbers",
    },
    _add,
)


class OfCrowd(StepPanel):
    """A panel of the active crowd, which `crowd(context, layout, crowd)` draws."""

    bl_parent_id = "CROWDLOD_PT_crowd"

    @classmethod
    def poll(cls, context) -> bool:
        return len(context.scene.crowd_lod.crowds) > 0

    def body(self, context, layout, settings) -> None:
        self.crowd(context, layout, active_crowd(settings))


def parts_shown(scene: bpy.types.Scene) -> list[Trajectory]:
    """Return the trajectory of each crowd up to the active one, as the overlay shows them.

    [] if it does not show the active one.
    """
    frame = viewport_overlay.latest(scene)
    parts = frame.trajectory.parts if frame is not None else ()
    index = index_of_active(scene.crowd_lod)
    return list(parts[: index + 1]) if index < len(parts) else []


CLASSES = (CROWDLOD_UL_crowds,)
