"""The exceptions: their settings, their list in the sidebar, and its buttons."""

import bpy

from ...crowd_lod.levels.assignment import MOST_LEVELS
from ..blender.labeled_properties import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from ..blender.operator import Reporting
from ..crowd import needs
from ..crowd.shot_exceptions import REGIONS
from .settings_list import Moving, Removing, SwitchedRow


class CrowdLodException(bpy.types.PropertyGroup):
    """An exception, called `name`: for some agents, in some frames."""

    use: BoolProperty(name="Use", default=True, description="The exception counts")
    kind: EnumProperty(
        name="Asks For",
        description="What is asked for these agents",
        items=[
            ("NEVER_COARSER", "Never Coarser Than", "They never have a LOD with fewer triangles than this one"),
            ("ALWAYS", "Always", "They always have this LOD"),
            ("HIDE", "Hide", "They are not there, nor are their shadows and reflections"),
            ("NUDGE", "Nudge", "They stand and walk beside their own way"),
            ("TURN", "Turn", "They face beside their own heading"),
            ("GROUP", "Swap Group", "They are of this character group"),
        ],
    )
    level: IntProperty(name="LOD", min=0, max=MOST_LEVELS - 1, description="The LOD that the exception speaks of")
    move: FloatVectorProperty(
        name="Nudge",
        size=3,
        min=-100_000,
        max=100_000,
        subtype="TRANSLATION",
        unit="LENGTH",
        description="By which way they stand beside their own, along the world's axes",
    )
    turn: FloatProperty(
        name="Turn", subtype="ANGLE", description="By which angle they face beside their own heading, counter-clockwise from above"
    )
    group_name: StringProperty(name="Group", description="The character group that they are of")
    share: FloatProperty(
        name="Share",
        default=1,
        min=0,
        max=1,
        subtype="FACTOR",
        description="Part of those in the region or on the map that Find Agents takes",
    )
    share_seed: IntProperty(name="Seed", min=0, description="Another seed takes another part of them")
    chosen_by: EnumProperty(
        name="Agents By",
        description="Which agents the exception is for",
        items=[
            ("NUMBERS", "Numbers", "Agents with these numbers; the eyedropper tells an agent's"),
            ("REGION", "Region", "Agents whose feet stand in the box about an object, when the exception begins"),
            ("MAP", "Painted Map", "Agents that stand on pixels lighter than a half, when the exception begins"),
            ("VOLUME", "Volume", "Agents whose middle is inside a closed mesh, when the exception begins"),
        ],
    )
    agents: StringProperty(
        name="Agents",
        description="Numbers and ranges of agents, such as 12, 40-50; after # the numbers of a file's own, such as #1007",
    )
    region: PointerProperty(
        type=bpy.types.Object,
        name="Region",
        poll=lambda _, candidate: candidate.type in REGIONS,
        description="A mesh or an empty. Its box in its own space chooses agents, a flat one at every height; or its volume",
    )
    map_image: PointerProperty(
        type=bpy.types.Image, name="Map", description="Painted over the ground: white chooses, black does not"
    )
    all_frames: BoolProperty(name="All Frames", default=True, description="The exception holds in the whole shot")
    first_frame: IntProperty(name="First Frame", default=1, subtype="TIME", description="From which on the exception holds")
    last_frame: IntProperty(name="Last Frame", default=120, subtype="TIME", description="Up to which the exception holds")


class CROWDLOD_UL_exceptions(SwitchedRow, bpy.types.UIList):
    """One exception a row: its switch, its name and what it asks for."""

    @staticmethod
    def told(item) -> str:
        return asks(item)


def asks(item) -> str:
    """Return what an exception asks for, in few words."""
    known = {"NEVER_COARSER": f"LOD {item.level} or finer", "ALWAYS": f"LOD {item.level}", "HIDE": "hidden"}
    known |= {"NUDGE": "nudged", "TURN": "turned", "GROUP": item.group_name}
    return known.get(item.kind, "unknown")  # of another version's file


class CROWDLOD_OT_add_exception(Reporting, bpy.types.Operator):
    """Add an exception, for agents that it names"""

    bl_idname = "crowd_lod.add_exception"
    bl_label = "Add Exception"

    def run(self, context) -> str:
        return _added(context.scene.crowd_lod, "Exception", "")


class CROWDLOD_OT_except_agent(Reporting, bpy.types.Operator):
    """Add an exception, for the agent that the eyedropper picked"""

    bl_idname = "crowd_lod.except_agent"
    bl_label = "Add Exception for Picked Agent"
    needs = (needs.picked,)

    def run(self, context) -> str:
        agent = context.scene.crowd_lod.agent
        return _added(context.scene.crowd_lod, f"Agent {agent}", str(agent))


def _added(settings, name: str, agents: str) -> str:
    entry = settings.exceptions.add()
    entry.name, entry.agents = name, agents
    settings.exception_index = len(settings.exceptions) - 1
    return f"{name} is added: set what it asks for."


class CROWDLOD_OT_remove_exception(Removing, bpy.types.Operator):
    """Remove the selected exception"""

    bl_idname = "crowd_lod.remove_exception"
    bl_label = "Remove Exception"
    kind, needs = "exception", (needs.exceptions,)


class CROWDLOD_OT_move_exception(Moving, bpy.types.Operator):
    """Move the selected exception: of two for the same agent, the lower one holds"""

    bl_idname = "crowd_lod.move_exception"
    bl_label = "Move Exception"
    kind, needs = "exception", (needs.exceptions,)


CLASSES = (
    CrowdLodException,
    CROWDLOD_UL_exceptions,
    CROWDLOD_OT_add_exception,
    CROWDLOD_OT_except_agent,
    CROWDLOD_OT_remove_exception,
    CROWDLOD_OT_move_exception,
)
