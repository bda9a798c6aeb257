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

    use: BoolProperty(name="Use", default=True, description="Apply the override")
    type: EnumProperty(
        name="Type",
        description="What the override does",
        items=[
            (
                "NEVER_COARSER",
                "Never Coarser",
                "Agents never get a coarser LOD than this one",
            ),
            ("ALWAYS", "Pin LOD", "Agents always have this LOD"),
            ("HIDE", "Hide", "Agents are removed, with their shadows and reflections"),
            ("NUDGE", "Nudge", "Agents are moved aside from their path"),
            ("GROUP", "Swap Group", "Agents are shown as this character group"),
        ],
    )
    level: IntProperty(name="LOD", min=0, max=MOST_LEVELS - 1, description="LOD of the override")
    move: FloatVectorProperty(
        name="Nudge",
        size=3,
        min=-100_000,
        max=100_000,
        subtype="TRANSLATION",
        unit="LENGTH",
        description="Distance by which agents are moved aside, along the world's axes",
    )
    group_name: StringProperty(name="Group", description="Character group that agents are shown as")
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
        description=(
            "Mesh or empty whose box, in its own space, selects agents; a flat box selects at "
            "every height"
        ),
    )
    all_frames: BoolProperty(
        name="All Frames", default=True, description="The override applies to the whole shot"
    )
    first_frame: IntProperty(
        name="First Frame",
        default=1,
        subtype="TIME",
        description="First frame of the override",
    )
    last_frame: IntProperty(
        name="Last Frame",
        default=120,
        subtype="TIME",
        description="Last frame of the override",
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
        description=(
            "How much more time, memory and instances a shot may cost than LODs by distance, for "
            "fewer visible LOD switches"
        ),
    )
    budget_triangles: IntProperty(
        name="Triangles",
        min=0,
        description=(
            "Most triangles of visible characters in any frame; the tolerance rises until they "
            "fit. 0 is no limit"
        ),
    )
    budget_memory: FloatProperty(
        name="Memory",
        min=0,
        soft_max=16_000,
        precision=0,
        description=(
            "Most megabytes of the characters in any frame of the shot; the tolerance rises until "
            "they fit. 0 is no limit"
        ),
    )
    budget_finest: IntProperty(
        name="Agents at LOD 0",
        min=0,
        description=(
            "Most visible agents at full detail in any frame; the tolerance rises until they fit. "
            "0 is no limit"
        ),
    )
    shot_plan: StringProperty(
        name="Shot Plan",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        update=settings_changed("shot_plan"),
        description="File with the LODs of every character in every frame, as Plan Shot made it; "
        "without it LODs are chosen by distance",
    )
    use_shot_plan: BoolProperty(
        name="Use Shot Plan",
        default=True,
        description="Overlay, Preview, Build and Bake show the LODs of the shot plan",
    )
    overrides: CollectionProperty(
        type=CrowdLodOverride,
        name="Overrides",
        description=(
            "Exceptions from the crowd and its LODs; of two for the same agent, the lower one in "
            "the list applies"
        ),
    )
    override_index: IntProperty(
        name="Override", min=0, description="The override that is selected in the list"
    )


class PreviewSettings:
    """The pictures of a preview."""

    step: IntProperty(
        name="Step", default=10, min=1, description="Render every N-th frame of a range"
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
        name="Frames", default=3, min=1, description="Number of frames to render, evenly chosen"
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
        description=(
            "Write 16 moving prototypes of each action instead of still poses: exact phases and "
            "motion blur of limbs, but a larger file"
        ),
    )
    frames_per_task: IntProperty(
        name="Frames per Task",
        default=10,
        min=1,
        description="Frames that a task of the farm job renders",
    )
