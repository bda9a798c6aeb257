"""Settings of the steps Plan Shot, Preview and Verify."""

import bpy

from ..blender.labeled_properties import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from ..blender.output_folders import BLEND_NAME
from .exception_settings import CrowdLodException
from .setting_changes import settings_changed

COLORS = (
    ("LOD", "By LOD", "Red, green, blue from near to far"),
    ("MATERIAL", "Materials", "The characters' own materials"),
    ("ERROR", "By Error", "How many pixels an agent's LOD may be off: green to red"),
)


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

    own_frames: BoolProperty(
        name="Own Frame Range",
        description="Plan, preview and verify other frames than the scene's own range",
    )
    frame_start: IntProperty(
        name="Start", default=1, subtype="TIME", description="First frame of the shot"
    )
    frame_end: IntProperty(
        name="End", default=250, subtype="TIME", description="Last frame of the shot"
    )
    frames: StringProperty(
        name="Frame List",
        description="Frames as text, a range 1:120 or a list 1,40,80, in place of the range "
        "above; empty takes the range",
    )


class PlanSettings:
    """How a shot plan decides."""

    avoid_pops: FloatProperty(
        name="Extra Cost for Fewer Pops",
        default=0.05,
        min=0,
        soft_max=1,
        subtype="FACTOR",
        description="Part by which a shot's time, memory and triangles may grow so that fewer "
        "characters change their LOD in sight",
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
    exceptions: CollectionProperty(
        type=CrowdLodException,
        name="Overrides",
        description="From the crowd and its LODs as they follow from the settings; of two for the "
        "same agent, the lower one holds",
    )
    exception_index: IntProperty(
        name="Override", min=0, description="The override that is selected in the list"
    )


class PreviewSettings:
    """The pictures of a preview."""

    color: EnumProperty(
        name="Color", description="Colors of the characters in the previewed pictures", items=COLORS
    )
    engine: EnumProperty(
        name="Engine",
        description="What draws the previewed pictures",
        items=[
            ("WORKBENCH", "Workbench", "Plain and quick, as a solid viewport"),
            ("CYCLES", "Cycles", "Path tracing, with the scene's lights"),
            ("EEVEE", "EEVEE", "Rasterized, with the scene's lights"),
            (
                "OVERLAY",
                "Overlay",
                "A playblast: the picture of the viewport's overlay, in its color; by far the "
                "fastest",
            ),
        ],
    )
    above: PointerProperty(
        type=bpy.types.Object,
        name="View From Above",
        poll=lambda _, candidate: candidate.type == "CAMERA",
        description="Camera of the second picture; none looks straight down on crowd and frustum",
    )
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
    verify_width: IntProperty(
        name="Width",
        default=320,
        min=16,
        max=8192,
        subtype="PIXEL",
        description="Width of the pictures that are compared",
    )
    verify_samples: IntProperty(
        name="Samples",
        default=4,
        min=1,
        max=4096,
        description="Samples of each pixel that are rendered",
    )


class ExportSettings:
    """The USD file and the farm job of a shot."""

    usd_file: StringProperty(
        name="USD File",
        default="crowd.usdc",
        description="Name of the file for the crowd of the shot, in the folder usd of Output "
        "Folder: .usdc, .usda or .usd",
    )
    usd_animated: BoolProperty(
        name="Moving Prototypes",
        description="Each of 16 phases of an action is a prototype that moves, instead of poses "
        "between which agents change: exact phases and blurred limbs, but a larger file",
    )
    farm_chunk: IntProperty(
        name="Frames of a Task",
        default=10,
        min=1,
        description="Frames that a task of the farm job renders",
    )
