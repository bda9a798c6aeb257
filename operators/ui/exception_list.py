"""The exceptions: their list in the sidebar, and its buttons."""

import bpy

from ..blender.operator import Reporting
from ..settings import needs
from .settings_list import Moving, Removing, SwitchedRow


class CROWDLOD_UL_exceptions(SwitchedRow, bpy.types.UIList):
    """One exception a row: its switch, its name and what it asks for."""

    @staticmethod
    def words(item) -> str:
        """Return what an exception asks for, in few words."""
        words = {
            "NEVER_COARSER": f"LOD {item.level} or finer",
            "ALWAYS": f"LOD {item.level}",
            "HIDE": "hidden",
            "NUDGE": "nudged",
            "GROUP": item.group_name,
        }
        return words.get(item.kind, "unknown")  # of another version's file


class CROWDLOD_OT_add_exception(Reporting, bpy.types.Operator):
    """Add an override, for agents that it names"""

    bl_idname = "crowd_lod.add_exception"
    bl_label = "Add Override"

    def run(self, context) -> str:
        return _added(context.scene.crowd_lod, "Override", "")


class CROWDLOD_OT_except_agent(Reporting, bpy.types.Operator):
    """Add an override, for the agent that the eyedropper picked"""

    bl_idname = "crowd_lod.except_agent"
    bl_label = "Add Override for Picked Agent"
    needs = (needs.picked,)

    def run(self, context) -> str:
        agent = context.scene.crowd_lod.agent
        return _added(context.scene.crowd_lod, f"Agent {agent}", str(agent))


def _added(settings, name: str, agents: str) -> str:
    entry = settings.exceptions.add()
    entry.name = name
    entry.agents = agents
    settings.exception_index = len(settings.exceptions) - 1
    return f"{name} is added: set what it asks for."


class CROWDLOD_OT_remove_exception(Removing, bpy.types.Operator):
    """Remove the selected override"""

    bl_idname = "crowd_lod.remove_exception"
    bl_label = "Remove Override"
    kind = "exception"
    needs = (needs.exceptions,)


class CROWDLOD_OT_move_exception(Moving, bpy.types.Operator):
    """Move the selected override: of two for the same agent, the lower one holds"""

    bl_idname = "crowd_lod.move_exception"
    bl_label = "Move Override"
    kind = "exception"
    needs = (needs.exceptions,)


CLASSES = (
    CROWDLOD_UL_exceptions,
    CROWDLOD_OT_add_exception,
    CROWDLOD_OT_except_agent,
    CROWDLOD_OT_remove_exception,
    CROWDLOD_OT_move_exception,
)
