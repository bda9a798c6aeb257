"""Settings of the steps Plan Shot, Preview and Verify."""

from ..blender.labeled_properties import (
    BoolProperty,
    CollectionProperty,
    FloatProperty,
    IntProperty,
    StringProperty,
)
from ..blender.output_folders import BLEND_NAME
from .override_settings import CrowdLodOverride
from .setting_changes import settings_changed


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
