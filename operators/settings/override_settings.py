"""Settings of an override: what it asks for, for whom, and when."""

import bpy

from ...crowd_lod.levels.assignment import MOST_LEVELS
from ..blender.labeled_properties import (
    BoolProperty,
    EnumProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

REGIONS = "MESH", "EMPTY"  # types of objects that may mark a region


class CrowdLodOverride(bpy.types.PropertyGroup):
    """An override, called `name`: for some agents, in some frames."""

    use: BoolProperty(name="Use", default=True, description="The override counts")
    kind: EnumProperty(
        name="Asks For",
        description="What is asked for these agents",
        items=[
            (
                "NEVER_COARSER",
                "Never Coarser Than",
                "They never have a LOD with fewer triangles than this one",
            ),
            ("ALWAYS", "Always", "They always have this LOD"),
            ("HIDE", "Hide", "They are not there, nor are their shadows and reflections"),
            ("NUDGE", "Nudge", "They stand and walk beside their own way"),
            ("GROUP", "Swap Group", "They are of this character group"),
        ],
    )
    level: IntProperty(
        name="LOD", min=0, max=MOST_LEVELS - 1, description="The LOD that the override speaks of"
    )
    move: FloatVectorProperty(
        name="Nudge",
        size=3,
        min=-100_000,
        max=100_000,
        subtype="TRANSLATION",
        unit="LENGTH",
        description="By which way they stand beside their own, along the world's axes",
    )
    group_name: StringProperty(name="Group", description="The character group that they are of")
    chosen_by: EnumProperty(
        name="Agents By",
        description="Which agents the override is for",
        items=[
            ("NUMBERS", "Numbers", "Agents with these numbers; the eyedropper tells an agent's"),
            (
                "REGION",
                "Region",
                "Agents whose feet stand in the box about an object, when the override begins",
            ),
        ],
    )
    agents: StringProperty(
        name="Agents",
        description="Numbers and ranges of agents, such as 12, 40-50; after # the numbers of a "
        "file's own, such as #1007",
    )
    region: PointerProperty(
        type=bpy.types.Object,
        name="Region",
        poll=lambda _, candidate: candidate.type in REGIONS,
        description="A mesh or an empty. Its box in its own space chooses agents, a flat one at "
        "every height",
    )
    all_frames: BoolProperty(
        name="All Frames", default=True, description="The override holds in the whole shot"
    )
    first_frame: IntProperty(
        name="First Frame",
        default=1,
        subtype="TIME",
        description="From which on the override holds",
    )
    last_frame: IntProperty(
        name="Last Frame",
        default=120,
        subtype="TIME",
        description="Up to which the override holds",
    )


CLASSES = (CrowdLodOverride,)
