"""Settings of the steps Shot, Check and Hand Over, and of an override."""

import bpy

from ...crowd_lod.levels.assignment import MOST_LEVELS
from ..blender.labeled_properties import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from ..blender.output_folders import BLEND_NAME
from .setting_changes import settings_changed

REGIONS = "MESH", "EMPTY"  # types of objects that may mark a region


class CrowdLodOverride(bpy.types.PropertyGroup):
    """An override, called `name`: for some agents, in some frames."""

    use: BoolProperty(name="Use", default=True, description="The override counts")
    type: EnumProperty(
        name="Type",
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
    select_by: EnumProperty(
        name="Select By",
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


class FrameSettings:
    """The frames of the shot, and where output goes."""

    output_folder: StringProperty(
        name="Output Folder",
        default=f"//{BLEND_NAME}_crowd_lod",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="Folder for plan, previews, proofs and exports. "
        f"{BLEND_NAME} is the name of the .blend file",
    )

    frames: StringProperty(
        name="Frames",
        description="Frames of the shot, a range 1:120 or a list 1,40,80; empty takes the scene's "
        "range",
    )


class PlanSettings:
    """How a shot plan decides."""

    pop_reduction: FloatProperty(
        name="Pop Reduction (max. extra cost)",
        default=0.05,
        min=0,
        soft_max=1,
        subtype="FACTOR",
        description="Part by which a shot's time, memory and instances may cost more than LODs by "
        "distance so that fewer characters change their LOD in sight",
    )
    budget_triangles: IntProperty(
        name="Triangles",
        min=0,
        description="Triangles that the visible characters of any frame may have at most; the "
        "tolerance rises until they fit. 0 is no limit",
    )
    budget_memory: FloatProperty(
        name="Memory",
        min=0,
        soft_max=16_000,
        precision=0,
        description="Megabytes that the characters may take in any frame of the shot; the "
        "tolerance rises until they fit. 0 is no limit",
    )
    budget_finest: IntProperty(
        name="Agents at LOD 0",
        min=0,
        description="Visible agents of any frame that may have full detail at most; the tolerance "
        "rises until they fit. 0 is no limit",
    )
    shot_plan: StringProperty(
        name="Shot Plan",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        update=settings_changed("shot_plan"),
        description="File with the LODs of every character in every frame, as Plan Shot made it; "
        "none takes LODs by distance",
    )
    use_shot_plan: BoolProperty(
        name="Use Shot Plan",
        default=True,
        description="Overlay, Preview, Build and Bake show the LODs of the shot plan",
    )
    overrides: CollectionProperty(
        type=CrowdLodOverride,
        name="Overrides",
        description="From the crowd and its LODs as they follow from the settings; of two for the "
        "same agent, the lower one holds",
    )
    override_index: IntProperty(
        name="Override", min=0, description="The override that is selected in the list"
    )


class PreviewSettings:
    """The pictures of a preview."""

    step: IntProperty(
        name="Step", default=10, min=1, description="Take every so many frames of a range"
    )
    width: IntProperty(
        name="Width",
        default=960,
        min=16,
        max=8192,
        subtype="PIXEL",
        description="Width of the pictures",
    )


class VerifySettings:
    """The renders of a proof."""

    verify_count: IntProperty(
        name="Frames", default=3, min=1, description="Frames that are rendered, evenly chosen"
    )


class ExportSettings:
    """The USD file and the farm job of a shot."""

    usd_file: StringProperty(
        name="USD File",
        default="crowd.usdc",
        description="Name of the file for the crowd of the shot, in the folder usd of Output "
        "Folder: .usdc, .usda or .usd",
    )
    animated_prototypes: BoolProperty(
        name="Animated Prototypes",
        description="Each of 16 phases of an action is a prototype that moves, instead of poses "
        "between which agents change: exact phases and blurred limbs, but a larger file",
    )
    frames_per_task: IntProperty(
        name="Frames per Task",
        default=10,
        min=1,
        description="Frames that a task of the farm job renders",
    )
