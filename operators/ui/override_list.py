"""The overrides: their list in the sidebar."""

import bpy

from .settings_list import SettingsList, SwitchedRow


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
        return words.get(item.type, "unknown")  # of another version's file


def _add(context) -> str:
    settings = context.scene.crowd_lod
    settings.overrides.add().name = "Override"
    settings.override_index = len(settings.overrides) - 1
    return "Added an override: set its type and agents."


OVERRIDES = SettingsList(
    "override",
    {
        "add": "Add an override for some agents",
        "remove": "Remove the selected override",
        "move": "Move the selected override: of two for the same agent, the lower one applies",
    },
    _add,
)
CLASSES = (CROWDLOD_UL_overrides,)
