"""Settings of the step LODs, and what is known of each character group.

Thresholds push their neighbors along, as the stops of a color ramp do.
"""

import bpy
import numpy as np
from idprop.types import IDPropertyArray

from ...crowd_lod.crowd.strides import Plays
from ...crowd_lod.levels.assignment import MOST_LEVELS, pushed
from ..blender.labeled_properties import (
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
from .setting_changes import outdate, settings_changed

BEFORE = "crowd_lod_before"  # custom property of who has thresholds: those before a change


def push(owner: bpy.types.PropertyGroup, _) -> None:
    """Put the thresholds of the settings, or of a character group, in order (update callback)."""
    owner.id_data.crowd_lod.estimate = ""
    put_in_order(owner)


def push_all(settings: bpy.types.PropertyGroup, _) -> None:
    """Put all thresholds in order after level_count has changed (update callback)."""
    settings.estimate = ""
    for owner in (settings, *settings.groups):
        put_in_order(owner)


def note_thresholds(settings: bpy.types.PropertyGroup) -> None:
    """Remember thresholds as they are now.

    Needed where they were set without a call of their update callbacks.
    """
    for owner in (settings, *settings.groups):
        owner[BEFORE] = list(owner.thresholds)


def put_in_order(owner: bpy.types.PropertyGroup) -> None:
    """Let the changed threshold push the others, as far as there are LODs.

    Blender does not tell which value of an array has changed, so the values before are kept beside.
    A value that is not a number becomes what it was.
    """
    values = np.array(owner.thresholds, np.float64)
    before = _before(owner)
    changed = np.flatnonzero(values != before)
    ordered = np.where(np.isfinite(values), values, before)
    count = owner.id_data.crowd_lod.level_count - 1
    if count:
        pushing = min(changed[0], count - 1) if len(changed) else 0
        ordered[:count] = pushed(ordered[:count].tolist(), pushing)
    ordered = ordered.astype(np.float32)
    # noted before the property is set: setting it calls this again, which then finds no change
    owner[BEFORE] = ordered.tolist()
    if (ordered != values).any():
        owner.thresholds = ordered


def _before(owner: bpy.types.PropertyGroup) -> np.ndarray:
    """Return the thresholds that were noted last, the defaults where none were."""
    usual = np.array(owner.bl_rna.properties["thresholds"].default_array)
    noted = owner.get(BEFORE)
    if not isinstance(noted, IDPropertyArray) or len(noted) != len(usual):
        return usual
    return np.where(np.isfinite(noted), noted, usual)


THRESHOLDS = (0.15, 0.4, 0.6, 0.7, 0.8, 0.9, 1.0)


class HowItPlays:
    """What Populate found of how an action plays."""

    way: FloatProperty(
        name="Way",
        unit="LENGTH",
        description="Distance that the action travels in a cycle, which is removed from it",
    )
    plays: EnumProperty(
        name="Plays",
        description="What the action follows",
        default=Plays.IN_PLACE,
        items=[
            (Plays.GIVEN, "By Stride", "A stride that a custom property gives"),
            (Plays.WAY, "By Stride", "The distance that it travels in a cycle"),
            (Plays.FEET, "By Stride", "The distance that its feet walk in a cycle"),
            (Plays.IN_PLACE, "By Time", "It travels nowhere"),
            (Plays.OFF_SPEED, "By Time", "It travels at another speed than its agents walk"),
            (Plays.ASIDE, "By Time", "It travels, but not along Forward"),
            (Plays.NOBODY_WALKS, "By Time", "It travels, and its agents stand"),
        ],
    )


class CrowdLodAction(HowItPlays, bpy.types.PropertyGroup):
    """Measurements of the action that states name `name`, as one character group plays it.

    It holds the action, which so comes along when the scene is appended to another file.
    """

    action: PointerProperty(type=bpy.types.Action, name="Action", description="The action played")
    stride: FloatProperty(
        name="Stride",
        unit="LENGTH",
        description="Length walked in a cycle; 0 plays the action by time",
    )
    period: FloatProperty(
        name="Period", unit="TIME_ABSOLUTE", description="Seconds in a cycle of the action"
    )


class CrowdLodGroup(HowItPlays, bpy.types.PropertyGroup):
    """Measurements of the character group `name`, and its own LOD thresholds."""

    center: FloatProperty(
        name="Center", unit="LENGTH", description="Height of the bounding sphere's center"
    )
    radius: FloatProperty(
        name="Radius",
        unit="LENGTH",
        description="Radius of the bounding sphere over the whole action",
    )
    girth: FloatProperty(
        name="Girth",
        unit="LENGTH",
        description="Largest distance from the vertical axis over the whole action; 0 if not known",
    )
    stride: FloatProperty(
        name="Stride",
        unit="LENGTH",
        description="Length walked in a cycle; 0 plays the action by time",
    )
    period: FloatProperty(
        name="Period", unit="TIME_ABSOLUTE", description="Seconds in a cycle of the action"
    )
    share: FloatProperty(
        name="Share",
        min=0,
        soft_max=10,
        default=1,
        description="Share of the agents, in proportion to the other groups'",
    )
    scale: FloatVectorProperty(
        name="Scale",
        size=2,
        min=0.01,
        soft_max=3,
        default=(1, 1),
        description="Least and greatest size of its agents, drawn for each",
    )
    variant_of: StringProperty(
        name="Variant Of",
        description="The group whose agents wear this; empty if it is a group of agents",
    )
    chance: FloatProperty(
        name="Chance",
        default=1,
        min=0,
        max=1,
        description="Probability that an agent wears this in its slot",
    )
    slot: StringProperty(
        name="Slot",
        description="Slot of the group's wardrobe in which agents wear this; empty if it is not "
        "worn",
    )
    excludes: StringProperty(
        name="Excludes",
        description="Slots, separated by commas, that stay empty for agents who wear this",
    )
    actions: CollectionProperty(
        type=CrowdLodAction,
        name="Actions",
        description="Actions that states name, besides the group's own",
    )
    lowest: FloatProperty(
        name="Soles",
        unit="LENGTH",
        description="Height of its soles above the origin, over the whole action; 0 if near",
    )
    on_ground: BoolProperty(
        name="Stand on Ground",
        description="Put the lowest point of its soles on the ground, instead of its origin",
        update=settings_changed("on_ground"),
    )
    vertices: IntVectorProperty(
        name="Vertices", size=MOST_LEVELS, description="Vertices of each LOD"
    )
    triangles: IntVectorProperty(
        name="Triangles", size=MOST_LEVELS, description="Triangles of each LOD"
    )
    deviations: FloatVectorProperty(
        name="Deviation",
        size=MOST_LEVELS,
        unit="LENGTH",
        description="Largest distance found of each LOD's surface from the character's, both "
        "ways, over its action",
    )
    bounds: FloatVectorProperty(
        name="Bound",
        size=MOST_LEVELS,
        unit="LENGTH",
        description="Upper bound of each LOD's deviation, by which LODs are chosen",
    )
    rms: FloatVectorProperty(
        name="RMS",
        size=MOST_LEVELS,
        unit="LENGTH",
        description="Root mean square of the distances, in the worst pose",
    )
    worst: FloatVectorProperty(
        name="Worst Frame", size=MOST_LEVELS, description="Frame at which each LOD deviates most"
    )
    shaded: FloatVectorProperty(
        name="Shaded",
        size=MOST_LEVELS,
        default=(-1.0,) * MOST_LEVELS,
        description="Length per pixel from which on each LOD's shaded picture matches the "
        "character's; below 0 if not known",
    )
    diagonal: FloatProperty(
        name="Diagonal",
        unit="LENGTH",
        description="Diagonal of the bounding box; 0 while no LOD was measured",
    )
    finest: IntProperty(
        name="Finest LOD",
        min=0,
        max=MOST_LEVELS - 1,
        description="Finer LODs of this group are not built, to fit in Character Memory",
    )
    use_custom_thresholds: BoolProperty(
        name="Custom Thresholds", description="This group has LOD distances of its own"
    )
    thresholds: FloatVectorProperty(
        update=push,
        name="Threshold",
        precision=3,
        size=MOST_LEVELS - 1,
        min=0,
        max=1,
        default=THRESHOLDS,
        description="Part of the camera's far distance at which this group's next LOD begins",
    )


class LevelSettings:
    """How LODs are made and chosen."""

    choice: EnumProperty(
        update=outdate,
        name="Choose LODs",
        default="BY_TOLERANCE",
        description="How many LODs there are, and where they begin",
        items=[
            (
                "BY_DISTANCE",
                "By Distance",
                "Set how many LODs there are, what they keep and where they begin",
            ),
            (
                "BY_TOLERANCE",
                "By Tolerance",
                "Set how many pixels a LOD may deviate; all else follows, for every camera",
            ),
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
        description="Pixels of the rendered picture by which a LOD's surface may lie off the "
        "character's",
    )
    memory: FloatProperty(
        update=outdate,
        name="Character Memory",
        min=0,
        soft_max=16_000,
        precision=0,
        description="Most megabytes that the characters may take in a render: LODs are chosen to "
        "fit, with the least error. 0 is no limit",
    )
    level_count: IntProperty(
        update=push_all,
        name="Levels",
        default=3,
        min=1,
        max=MOST_LEVELS,
        description="LODs of each character, itself as LOD 0 included",
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
    thresholds: FloatVectorProperty(
        update=push,
        name="Threshold",
        precision=3,
        size=MOST_LEVELS - 1,
        min=0,
        max=1,
        default=THRESHOLDS,
        description="Part of the camera's far distance at which the next LOD begins",
    )
    bias_image: PointerProperty(
        type=bpy.types.Image,
        name="Detail Map",
        description="Image over the ground: on white, agents get the LOD of a quarter of their "
        "distance, on black of four times; gray changes nothing",
    )
