"""Buttons that override agents.

Each adds to the list of overrides, where its values can be set.
"""

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.shot.overrides import agents_text
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..blender.labeled_properties import EnumProperty, IntProperty
from ..blender.operator import Reporting
from ..scene.scene_crowd import trajectory_of
from ..scene.shot_overrides import find_agents
from ..scene.sources.crowd_overrides import without_overrides
from ..settings import needs
from ..settings.shot_settings import REGIONS
from ..viewport import viewport_overlay

NUDGE = 0.5  # meters by which one press moves
# type: name and icon of its button
BUTTONS = {
    "NUDGE": ("Nudge", "EMPTY_ARROWS"),
    "HIDE": ("Hide", "HIDE_ON"),
    "GROUP": ("Swap", "COMMUNITY"),
    "ALWAYS": ("Pin LOD", "PINNED"),
    "NEVER_COARSER": ("Never Coarser", "MOD_DECIM"),
}


class CROWDLOD_OT_override_agent(Reporting, bpy.types.Operator):
    bl_description = (
        "Change the picked agent in all frames; the list of overrides holds the change, its "
        "value and its switch"
    )
    bl_idname = "crowd_lod.override_agent"
    bl_label = "Override Agent"
    needs = (needs.crowd,)

    agent: IntProperty(
        name="Agent", default=-1, min=-1, description="The agent; -1 for the picked one"
    )
    level: IntProperty(
        name="LOD", default=-1, min=-1, description="The LOD to keep; -1 for the one that it has"
    )
    type: EnumProperty(
        name="Change",
        items=[
            ("NUDGE", "Nudge", "Move the agent half a meter along X; press again for more"),
            ("HIDE", "Hide", "Remove the agent and its shadow"),
            (
                "GROUP",
                "Swap Group",
                "Show the agent as the next character group; press again for the one after",
            ),
            ("ALWAYS", "Pin LOD", "Pin the LOD that the agent has now"),
            ("NEVER_COARSER", "Never Coarser", "Keep the LOD that it has now, or a finer one"),
        ],
    )

    @classmethod
    def description(cls, context, properties) -> str:
        return (
            f"{properties.bl_rna.properties['type'].enum_items[properties.type].description}, "
            f"in all frames"
        )

    def run(self, context) -> str:
        scene = context.scene
        settings = context.scene.crowd_lod
        if self.agent >= 0:
            settings.agent = self.agent
        if lack := needs.picked(scene):
            raise CrowdError(lack)
        dressed = trajectory_of(scene)
        trajectory = dressed.bare
        agent = settings.agent
        if dressed.wearer is not None and agent < len(dressed.wearer):
            agent = int(dressed.wearer[agent])
        if agent >= len(trajectory.start):
            raise CrowdError(
                f"There is no agent {agent}: the crowd has {len(trajectory.start):,}, numbered "
                f"from 0 on."
            )
        entry = _entry(
            settings,
            self.type,
            f"{BUTTONS[self.type][0]} {agent}",
            agents_text(np.array([agent]), trajectory.ids),
        )
        if self.type == "NUDGE":
            entry.move[0] += NUDGE / scene_data.meters(scene)
        elif self.type == "GROUP":
            entry.group_name = _next_group(trajectory, agent)
        elif self.type in ("ALWAYS", "NEVER_COARSER") and self.level >= 0:
            entry.level = self.level
        elif self.type in ("ALWAYS", "NEVER_COARSER"):
            frame = viewport_overlay.latest(scene)
            entry.level = (
                int(frame.levels[agent]) if frame is not None and agent < len(frame.crowd) else 0
            )
        return f"{entry.name}: its values and its switch are in the list of overrides."


def _entry(settings, type_: str, name: str, agents: str) -> bpy.types.PropertyGroup:
    """Return the override of this type for these agents alone, in all frames.

    It is added if there is none yet, and it is selected and switched on.
    """
    key = type_, "NUMBERS", agents, True
    keys = [
        (entry.type, entry.select_by, entry.agents.strip(), entry.all_frames)
        for entry in settings.overrides
    ]
    if key not in keys:
        added = settings.overrides.add()
        added.type = type_
        added.name = name
        added.agents = agents
    settings.override_index = keys.index(key) if key in keys else len(keys)
    entry = settings.overrides[settings.override_index]
    entry.use = True
    return entry


def _next_group(trajectory: Trajectory, agent: int) -> str:
    groups = [group for group in trajectory.groups if not group.slot]
    if len(groups) < 2:
        raise CrowdError(
            "There is one character group: add another to the collection of characters, and press "
            "Populate."
        )
    shown = trajectory.groups[trajectory.start.group[agent]]
    return groups[(groups.index(shown) + 1) % len(groups)].name


def _write_numbers(context, entry) -> str:
    """Write the agents whom the entry's region chooses now as its numbers.

    Returns a sentence; CrowdError if there are none.
    """
    trajectory = without_overrides(trajectory_of(context.scene))
    agents = find_agents(context.scene, entry, trajectory, context.evaluated_depsgraph_get())
    if not len(agents):
        raise CrowdError(
            f"The override {entry.name} selects no agents: none stand in {entry.region.name} at "
            f"this frame."
        )
    entry.agents = agents_text(agents, trajectory.ids)
    entry.select_by = "NUMBERS"
    return f"{entry.name}: {counted(len(agents), 'agent')} found, the same in all frames."


class CROWDLOD_OT_find_agents(Reporting, bpy.types.Operator):
    bl_description = "Store the numbers of the agents inside the region at this frame"
    bl_idname = "crowd_lod.find_agents"
    bl_label = "Find Agents"
    needs = needs.crowd, needs.place

    def run(self, context) -> str:
        settings = context.scene.crowd_lod
        return _write_numbers(context, settings.overrides[settings.override_index])


class CROWDLOD_OT_erase(Reporting, bpy.types.Operator):
    """Hide the agents inside the box of the active object at this frame"""

    bl_idname = "crowd_lod.erase"
    bl_label = "Erase in Active Object"
    needs = (needs.crowd,)

    def run(self, context) -> str:
        region = context.object
        settings = context.scene.crowd_lod
        if region is None or region.type not in REGIONS:
            raise CrowdError("No mesh or empty is active: select one around the agents to erase.")
        entry = settings.overrides.add()
        try:
            entry.select_by = "REGION"
            entry.name = f"Erase {region.name}"
            entry.type = "HIDE"
            entry.region = region
            sentence = _write_numbers(context, entry)
        except CrowdError:
            settings.overrides.remove(len(settings.overrides) - 1)
            raise
        settings.override_index = len(settings.overrides) - 1
        return sentence


def draw_agent_overrides(layout) -> None:
    """Draw the buttons that override the picked agent."""
    column = layout.column(align=True)
    for types in (("NUDGE", "HIDE", "GROUP"), ("ALWAYS", "NEVER_COARSER")):
        row = column.row(align=True)
        for type_ in types:
            text, icon = BUTTONS[type_]
            row.operator(
                "crowd_lod.override_agent", text=text, icon=icon, translate=False
            ).type = type_


CLASSES = (CROWDLOD_OT_override_agent, CROWDLOD_OT_find_agents, CROWDLOD_OT_erase)
