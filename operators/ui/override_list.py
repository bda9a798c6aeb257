"""The overrides: their list in the sidebar, and its buttons."""

import bpy

from ..blender.operator import Reporting
from ..settings import needs
from .settings_list import Moving, Removing, SwitchedRow


class CROWDLOD_UL_overrides(SwitchedRow, bpy.types.UIList):
    """One override a row: its switch, its name and what it asks for."""

    @staticmethod
    def words(item) -> str:
        """Return what an override asks for, in few words."""
        words = {
            "NEVER_COARSER": f"LOD {item.level} or finer",
            "ALWAYS": f"LOD {item.level}",
            "HIDE": "hidden",
            "NUDGE": "nudged",
            "GROUP": item.group_name,
        }
        return words.get(item.kind, "unknown")  # of another version's file


class CROWDLOD_OT_add_override(Reporting, bpy.types.Operator):
    """Add an override, for agents that it names"""

    bl_idname = "crowd_lod.add_override"
    bl_label = "Add Override"

    def run(self, context) -> str:
        return _added(context.scene.crowd_lod, "Override", "")


class CROWDLOD_OT_add_agent_override(Reporting, bpy.types.Operator):
    """Add an override, for the agent that the eyedropper picked"""

    bl_idname = "crowd_lod.add_agent_override"
    bl_label = "Add Override for Picked Agent"
    needs = (needs.picked,)

    def run(self, context) -> str:
        agent = context.scene.crowd_lod.agent
        return _added(context.scene.crowd_lod, f"Agent {agent}", str(agent))


def _added(settings, name: str, agents: str) -> str:
    entry = settings.overrides.add()
    entry.name = name
    entry.agents = agents
    settings.override_index = len(settings.overrides) - 1
    return f"{name} is added: set what it asks for."


class CROWDLOD_OT_remove_override(Removing, bpy.types.Operator):
    """Remove the selected override"""

    bl_idname = "crowd_lod.remove_override"
    bl_label = "Remove Override"
    kind = "override"
    needs = (needs.overrides,)


class CROWDLOD_OT_move_override(Moving, bpy.types.Operator):
    """Move the selected override: of two for the same agent, the lower one holds"""

    bl_idname = "crowd_lod.move_override"
    bl_label = "Move Override"
    kind = "override"
    needs = (needs.overrides,)


CLASSES = (
    CROWDLOD_UL_overrides,
    CROWDLOD_OT_add_override,
    CROWDLOD_OT_add_agent_override,
    CROWDLOD_OT_remove_override,
    CROWDLOD_OT_move_override,
)
