"""Settings, stored in the scene."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ...crowd_lod.levels.assignment import MOST_LEVELS
from ..crowd.renamed_settings import renamed
from ..crowd.scene_crowd import set_down
from ..crowd.threshold_order import push, push_all
from .exception_list import CrowdLodException

OLD = {"options": {"HIDDEN"}, "description": "Old name of this setting, for older files and scripts"}
METHODS = (
    ("AUTO", "Automatic", "Make each mesh by both methods, measure how far it is off in motion, and take the closer one"),
    ("POSE_AWARE", "Pose-Aware", "Quadric edge collapse that heeds the poses of the action and keeps UV seams"),
    ("DECIMATE", "Decimate Modifier", "Blender's own, which looks at the rest pose; it is quicker"),
)
OLD_METHODS = "AUTO", "FAST", "PRECISE"  # how files call these
COLORS = (
    ("LOD", "By LOD", "Red, green, blue from near to far"),
    ("MATERIAL", "Materials", "The characters' own materials"),
)
OVERLAY_COLORS = (
    COLORS[0],
    ("STATE", "By State", "The colors of the state machine"),
    ("GROUP", "By Group", "A color a character group"),
    ("REASON", "By Reason", "Why an agent is culled, or has not the finest LOD"),
    ("MATERIAL", "Materials", "Base color or image of the characters' own materials"),
)
SIZES = (200, 80, 40, 20, 10, 5, 2)
THRESHOLDS = (0.15, 0.4, 0.6, 0.7, 0.8, 0.9, 1.0)


def outdate(settings, _) -> None:
    """Clear the cost estimate: update callback of settings that change the cost."""
    settings.estimate = ""


class CrowdLodGroup(bpy.types.PropertyGroup):
    """Measurements of the character group `name`, and its own LOD thresholds."""

    center: renamed(FloatProperty, "center", name="Center", unit="LENGTH", description="Height of the bounding sphere's center")
    centre: FloatProperty(name="Center", **OLD)
    radius: FloatProperty(name="Radius", unit="LENGTH", description="Radius of the bounding sphere over the whole action")
    stride: FloatProperty(name="Stride", unit="LENGTH", description="Metres walked in a cycle; 0 plays the action by time")
    period: FloatProperty(name="Period", unit="TIME_ABSOLUTE", description="Seconds in a cycle of the action")
    lowest: FloatProperty(name="Lowest Point", unit="LENGTH", description="Height above the origin, over the action; 0 if near")
    on_ground: BoolProperty(
        name="Stand on Ground",
        description="Its lowest point over the whole action stands on the ground, instead of its origin",
        update=set_down,
    )
    vertices: IntVectorProperty(name="Vertices", size=MOST_LEVELS, description="Vertices of each LOD")
    triangles: IntVectorProperty(name="Triangles", size=MOST_LEVELS, description="Triangles of each LOD")
    deviations: FloatVectorProperty(
        name="Deviation",
        size=MOST_LEVELS,
        unit="LENGTH",
        description="Largest distance found of each LOD's surface from the character's, both ways, over its action",
    )
    bounds: FloatVectorProperty(
        name="Bound", size=MOST_LEVELS, unit="LENGTH", description="Upper bound of each LOD's deviation, by which LODs are chosen"
    )
    rms: FloatVectorProperty(
        name="RMS", size=MOST_LEVELS, unit="LENGTH", description="Root mean square of the distances, in the worst pose"
    )
    worst: FloatVectorProperty(name="Worst Frame", size=MOST_LEVELS, description="Frame at which each LOD deviates most")
    shaded: FloatVectorProperty(
        name="Shaded",
        size=MOST_LEVELS,
        default=(-1.0,) * MOST_LEVELS,
        description="Length per pixel from which on each LOD's shaded picture matches the character's; below 0 if not known",
    )
    diagonal: FloatProperty(name="Diagonal", unit="LENGTH", description="Of the bounding box; 0 while no LOD was measured")
    finest: IntProperty(
        name="Finest LOD",
        min=0,
        max=MOST_LEVELS - 1,
        description="Finer LODs of this group are not built, to fit in Memory for Characters",
    )
    own_thresholds: BoolProperty(name="Own Thresholds", description="This group has LOD distances of its own")
    thresholds: FloatVectorProperty(
        update=push("thresholds"),
        name="Threshold",
        precision=3,
        size=MOST_LEVELS - 1,
        min=0,
        max=1,
        default=THRESHOLDS,
        description="Part of the camera's far distance at which this group's next LOD begins",
    )
    sizes: FloatVectorProperty(
        update=push("sizes"),
        name="Size",
        size=MOST_LEVELS - 1,
        min=0.01,
        default=SIZES,
        description="Height of this group's character in pixels below which its next LOD begins",
    )


class CrowdLodSettings(bpy.types.PropertyGroup):
    """The crowd of a scene: all settings that its plan depends on.

    Everything else that a plan depends on is in the scene itself.
    """

    characters: PointerProperty(
        type=bpy.types.Collection,
        name="Characters",
        description="Collection whose children, collections or objects, are the character groups",
    )
    keep_characters: BoolProperty(
        name="Keep in Renders",
        description="Build and Preview leave the characters themselves in the picture, where they stand, besides the crowd",
    )
    forward: EnumProperty(
        name="Forward",
        description="The way the characters face where they stand",
        items=[("-Y", "-Y", "Blender's front"), ("Y", "+Y", "Blender's back"), ("X", "+X", "Right"), ("-X", "-X", "Left")],
    )
    count: IntProperty(
        update=outdate,
        name="Agents",
        default=1000,
        min=0,
        soft_max=1_000_000,
        max=MOST_AGENTS,
        description="Number of agents in the crowd",
    )
    seed: IntProperty(name="Seed", min=0, description="The same seed gives the same crowd")
    center: renamed(
        FloatVectorProperty, "center", name="Center", size=3, subtype="TRANSLATION", description="Center of the crowd's ground"
    )
    centre: FloatVectorProperty(name="Center", size=3, **OLD)
    size: FloatVectorProperty(
        name="Size",
        size=2,
        default=(60, 60),
        subtype="XYZ",
        unit="LENGTH",
        min=0,
        description="Width (X) and depth (Y) of the crowd's ground",
    )
    map_image: PointerProperty(
        type=bpy.types.Image,
        name="Map",
        description="Label map over the ground: each pixel in the color of a label. None is open ground between two edges",
    )
    height_image: PointerProperty(
        type=bpy.types.Image,
        name="Height Map",
        description="Heights over the ground, from the first channel; agents stand on it. None is level ground",
    )
    height_scale: FloatProperty(
        name="Height", default=1.0, unit="LENGTH", description="Height of the value 1 (white) above that of 0 (black)"
    )
    tilt: BoolProperty(name="Align to Slope", description="Agents on a height map stand square on its slope instead of upright")
    machine: PointerProperty(
        type=bpy.types.Text,
        name="State Machine",
        description="What agents do on each label, as JSON. None lets them walk to and fro between the edges",
    )
    first_frame: IntProperty(
        name="Start Frame", default=1, subtype="TIME", description="Before it the crowd stands where it was populated"
    )
    choice: EnumProperty(
        update=outdate,
        name="Choose LODs",
        default="BY_TOLERANCE",
        description="How many LODs there are, and where they begin",
        items=[
            ("BY_RATIO", "By Ratio", "Set how many LODs there are, what they keep and where they begin"),
            ("BY_TOLERANCE", "By Tolerance", "Set how many pixels a LOD may deviate; all else follows, for every camera"),
        ],
    )
    tolerance: FloatProperty(
        update=outdate,
        name="Tolerance",
        default=1.0,
        min=0,
        soft_min=0.1,
        soft_max=10,
        subtype="PIXEL",
        description="Pixels of the rendered picture by which a LOD's surface may lie off the character's",
    )
    memory: FloatProperty(
        update=outdate,
        name="Memory for Characters",
        min=0,
        soft_max=16_000,
        precision=0,
        description="Megabytes that the characters may take in a render: LODs are chosen to fit, where they deviate least. 0 is no limit",
    )
    shading_counts: BoolProperty(
        name="Shading Counts",
        description="By tolerance, a LOD also begins only where its shaded picture differs by 2 % of white at most",
    )
    level_count: IntProperty(
        update=push_all,
        name="Levels",
        default=3,
        min=1,
        max=MOST_LEVELS,
        description="LODs of each character, itself as LOD 0 included",
    )
    scale_textures: BoolProperty(
        name="Scale Textures",
        description="Build and Bake show far LODs with images scaled down to what can be seen of them where each begins",
    )
    ratios: FloatVectorProperty(
        update=outdate,
        name="Ratio",
        precision=3,
        size=MOST_LEVELS,
        min=0.001,
        max=1,
        default=(1.0, 0.4, 0.12, 0.05, 0.03, 0.02, 0.015, 0.01),
        description="Part of the triangles that each LOD keeps",
    )
    method: renamed(
        EnumProperty,
        "method",
        name="Decimation",
        description="How the LOD meshes are made",
        items=METHODS,
        old=OLD_METHODS,
    )
    way: EnumProperty(
        name="Decimation", **OLD, items=[(old, *method[1:]) for old, method in zip(OLD_METHODS, METHODS, strict=True)]
    )
    thresholds: FloatVectorProperty(
        update=push("thresholds"),
        name="Threshold",
        precision=3,
        size=MOST_LEVELS - 1,
        min=0,
        max=1,
        default=THRESHOLDS,
        description="Part of the camera's far distance at which the next LOD begins",
    )
    metric: EnumProperty(
        update=outdate,
        name="Distance",
        description="How the distance that chooses an agent's LOD is measured",
        items=[
            ("AXIS", "Along the View", "Depth, which size on screen depends on"),
            ("RADIAL", "From the Camera", "Straight distance; panoramic cameras always use it"),
            ("PIXELS", "By Size in Pixels", "Size in the picture, so that a zoom changes the LOD"),
        ],
    )
    sizes: FloatVectorProperty(
        update=push("sizes"),
        name="Size",
        size=MOST_LEVELS - 1,
        min=0.01,
        default=SIZES,
        description="Height of a character in pixels below which the next LOD begins",
    )
    hysteresis: FloatProperty(
        name="Hysteresis",
        min=0,
        max=0.5,
        subtype="FACTOR",
        description="How far an agent must pass a LOD's distance before it changes LOD in the overlay, as a part of that "
        "distance. Preview and build have none",
    )
    bias_image: PointerProperty(
        type=bpy.types.Image,
        name="Detail Map",
        description="Painted over the ground: white gives the LOD of a quarter of the distance, black of four times, gray no change",
    )
    cull_to_border: BoolProperty(
        name="Cull to Render Region", description="Leave out what lies outside the render region, where one is set"
    )
    drop_lost: BoolProperty(
        name="Drop Lost Agents", description="Leave out agents at NaN or infinity, and count them, instead of stopping"
    )
    margin_kind: EnumProperty(
        name="Margin",
        description="By how much the camera's frustum is widened, for characters that reach into it from outside",
        items=[
            ("DERIVED", "From Bounds", "Widen the frustum just so far that no character that may touch a pixel is dropped"),
            ("FIXED", "Fixed", "Widen the frustum by a distance of your own; may drop characters"),
        ],
    )
    margin: FloatProperty(
        name="Margin", default=1.0, min=0, unit="LENGTH", description="Distance by which the frustum's sides are moved out"
    )
    shadows: BoolProperty(
        name="Shadows and Reflections",
        default=True,
        description="Keep characters outside the picture whose shadows fall into it, or that mirrors show; the camera itself "
        "does not see them",
    )
    mirrors: PointerProperty(
        type=bpy.types.Collection, name="Mirrors", description="Collection of flat objects that mirror the crowd"
    )
    unseen_level: IntProperty(
        name="LOD If Unseen",
        default=MOST_LEVELS - 1,
        min=0,
        max=MOST_LEVELS - 1,
        description="Level of detail of characters kept for their shadow or reflection alone, or the coarsest there is",
    )
    color: renamed(EnumProperty, "color", name="Color", description="Colors of the characters in previewed pictures", items=COLORS)
    colour: EnumProperty(name="Color", items=COLORS, **OLD)
    engine: EnumProperty(
        name="Engine",
        description="What draws the previewed pictures",
        items=[
            ("WORKBENCH", "Workbench", "Plain and quick, as a solid viewport"),
            ("CYCLES", "Cycles", "Path tracing, with the scene's lights"),
            ("EEVEE", "EEVEE", "Rasterized, with the scene's lights"),
            ("OVERLAY", "Overlay", "A playblast: the picture of the viewport's overlay, in its color; by far the fastest"),
        ],
    )
    above: PointerProperty(
        type=bpy.types.Object,
        name="View From Above",
        poll=lambda _, candidate: candidate.type == "CAMERA",
        description="Camera of the second picture; none looks straight down on crowd and frustum",
    )
    frames: StringProperty(name="Frames", default="1:120", description="Frames to preview: a range 1:120 or a list 1,40,80")
    step: IntProperty(name="Step", default=10, min=1, description="Preview every so many frames of a range")
    width: IntProperty(name="Width", default=960, min=16, max=8192, subtype="PIXEL", description="Width of the pictures")
    folder: StringProperty(
        name="Output",
        default="//crowd_lod",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="Folder for the preview's pictures, table and plan",
    )
    avoid_pops: FloatProperty(
        name="Avoid Pops",
        default=0.05,
        min=0,
        soft_max=1,
        subtype="FACTOR",
        description="Part by which a shot's time, memory and triangles may grow so that fewer characters change their LOD in sight",
    )
    plan_blurred: BoolProperty(
        name="Coarser Where Blurred",
        description="With motion blur or depth of field, LODs may deviate by as many pixels more as the character is blurred wide",
    )
    budget_triangles: IntProperty(
        name="Triangles",
        min=0,
        description="Triangles that the visible characters of any frame may have at most; the tolerance rises until they fit. 0 is no limit",
    )
    budget_memory: FloatProperty(
        name="Memory",
        min=0,
        soft_max=16_000,
        precision=0,
        description="Megabytes that the characters may take in any frame of the shot; the tolerance rises until they fit. 0 is no limit",
    )
    plan_folder: StringProperty(
        name="Plan Folder",
        default="//crowd_lod_plan",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="Folder for the shot plan and its report",
    )
    shot_plan: StringProperty(
        name="Shot Plan",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="File with the LODs of every character in every frame, as Plan Shot made it; none takes LODs by distance",
    )
    use_shot_plan: BoolProperty(
        name="Use Shot Plan", default=True, description="Overlay, Preview, Build and Bake show the LODs of the shot plan"
    )
    exceptions: CollectionProperty(
        type=CrowdLodException, name="Exceptions", description="From the shot plan; of two for the same agent, the lower one holds"
    )
    exception_index: IntProperty(name="Exception", min=0, description="The exception that is selected in the list")
    overlay: BoolProperty(name="Overlay", description="Draw the crowd at its LODs in the viewport")
    overlay_mode: EnumProperty(
        name="Display As",
        description="How the overlay draws the agents",
        items=[
            ("MESHES", "LOD Meshes", "Every character at its LOD, each in its own step of the action"),
            ("BOXES", "Boxes", "As high and wide as the characters; for very many"),
            ("POINTS", "Points", "As wide as the characters; for very many"),
        ],
    )
    overlay_color: renamed(
        EnumProperty,
        "overlay_color",
        name="Overlay Color",
        description="Colors of the agents in the overlay",
        items=OVERLAY_COLORS,
    )
    overlay_colour: EnumProperty(name="Overlay Color", items=OVERLAY_COLORS, **OLD)
    overlay_camera: EnumProperty(
        name="Seen From",
        description="View that culls agents and chooses LODs in the overlay",
        items=[
            ("SCENE", "Scene Camera", "Culling and LODs are those of the scene's camera"),
            ("VIEWPORT", "Viewport", "Culling and LODs are those of each viewport's own view"),
        ],
    )
    hud: BoolProperty(name="Statistics", default=True, description="Write counts, times and memory over the viewport")
    inset: BoolProperty(
        name="Inset From Above", description="Show the crowd, the camera's frustum and the LOD ranges from above in a corner"
    )
    agent: IntProperty(name="Agent", default=-1, min=-1, description="The agent that the overlay marks and describes; -1 is none")
    overlay_culled: BoolProperty(
        name="Culled Agents",
        default=True,
        description="Show culled agents as faint points; of a crowd of more than 100,000 every second, third, and so on",
    )
    overlay_fade: FloatProperty(
        name="Cross-Fade",
        min=0,
        max=0.5,
        subtype="FACTOR",
        description="Part of a LOD's distance over which it dissolves into the next one, in a dither pattern; 0 switches at once",
    )
    version: IntProperty(name="Version", min=0, description="Which version of Crowd LOD these settings are of")
    # what the steps made and measured; found by pointer, so a rename does not lose it
    groups: CollectionProperty(type=CrowdLodGroup, name="Character Groups", description="What was measured of each")
    trouble: StringProperty(name="Trouble", description="Agents that get stuck, found by Populate")
    memory_tolerance: FloatProperty(
        name="Tolerance for Memory",
        min=0,
        subtype="PIXEL",
        description="Pixels that LODs deviate so that they fit in Memory for Characters, as Make LOD Meshes found; 0 without a limit",
    )
    memory_made: FloatProperty(name="Memory Limit of LODs", description="Memory for Characters when LOD meshes were last made")
    dropped: StringProperty(name="Not Made", description="LODs that were not made by tolerance, and why, a line each")
    estimate: StringProperty(name="Estimate", description="What the crowd costs to render, as Estimate Cost found: a table")
    levels: PointerProperty(type=bpy.types.Collection, name="LOD Meshes", description="Made by Make LOD Meshes")
    build: PointerProperty(type=bpy.types.Collection, name="Build", description="Made by Build or Bake")


CLASSES = (CrowdLodGroup, CrowdLodSettings)
