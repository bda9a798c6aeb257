"""Settings, stored in the scene.

Each is described once, as a property of a class in this folder: its name, type, range, default and
text. Presets, panels, commands and the pages of reference take them from there.
"""

from typing import Any

import bpy

from ..blender.labeled_properties import (
    CollectionProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from .crowd_settings import (
    CROWD,
    CROWD_NAMES,
    BehaviorSettings,
    CameraSettings,
    CharacterSettings,
    CrowdLodCrowd,
    CrowdSettings,
    SimulationSettings,
)
from .crowds import active_or_new, first_crowd
from .level_settings import CrowdLodAction, CrowdLodGroup, LevelSettings
from .overlay_settings import OverlaySettings
from .setting_changes import settings_changed
from .shot_settings import (
    ExportSettings,
    FrameSettings,
    PlanSettings,
    PreviewSettings,
    VerifySettings,
)

# The settings of each step of the work, by its panel's name.
STEPS: dict[str, tuple[type, ...]] = {
    "Crowd": (CharacterSettings, CrowdSettings, BehaviorSettings, SimulationSettings),
    "LODs": (LevelSettings,),
    "Shot": (FrameSettings, PlanSettings, CameraSettings),
    "Check": (PreviewSettings, VerifySettings),
    "Hand Over": (ExportSettings,),
    "Overlay": (OverlaySettings,),
}
ALL = tuple(part for parts in STEPS.values() for part in parts)


class CrowdLodSettings(*(part for part in ALL if part not in CROWD), bpy.types.PropertyGroup):
    """The crowds of a scene: all settings that its plan depends on, and what its steps made.

    Everything else that a plan depends on is in the scene itself. For scripts it has the settings
    of the first crowd as its own, and `active_crowd`; both make a crowd if there is none.
    """

    active_crowd = property(active_or_new)

    crowds: CollectionProperty(
        type=CrowdLodCrowd, name="Crowds", description="All crowds of the scene"
    )
    crowd_index: IntProperty(
        update=settings_changed("active_crowd"),
        name="Active Crowd",
        min=0,
        description="Which of the crowds the sidebar shows",
    )
    pop_reduction_percent: FloatProperty(
        name="Pop Reduction (max. extra cost)",
        get=lambda settings: 100 * settings.pop_reduction,
        set=lambda settings, value: setattr(settings, "pop_reduction", value / 100),
        min=0,
        soft_max=100,
        precision=1,
        subtype="PERCENTAGE",
        description=(
            "Pop Reduction in percent: how much more time, memory and instances a shot may cost "
            "than LODs by distance, for fewer visible LOD switches"
        ),
    )
    groups: CollectionProperty(
        type=CrowdLodGroup,
        name="Character Groups",
        description="Character groups, and what was measured of each",
    )
    trouble: StringProperty(
        name="Trouble",
        description="What Populate found that may be wrong: messages as JSON",
    )
    memory_tolerance: FloatProperty(
        name="Tolerance for Memory",
        min=0,
        subtype="PIXEL",
        description="Pixels that LODs deviate so that they fit in Character Memory, as Make "
        "LOD Meshes found; 0 without a limit",
    )
    memory_made: FloatProperty(
        name="Memory Limit of LODs",
        description="Character Memory when LOD meshes were last made",
    )
    dropped: StringProperty(
        name="Not Made",
        description="LODs that were not made by tolerance, and why: messages as JSON",
    )
    shot_verdict: StringProperty(
        name="Verdict",
        description="The worst that a viewer may notice in the planned shot, as Plan Shot found: "
        "numbers as JSON",
    )
    shot_budgets: StringProperty(
        name="Possible Budgets",
        description="What the planned shot takes at the least, by the pixels that LODs may "
        "deviate, as Plan Shot found: numbers as JSON",
    )
    estimate: StringProperty(
        name="Estimate",
        description="What the crowd costs to render, as Estimate Cost found: a table as JSON",
    )
    levels: PointerProperty(
        type=bpy.types.Collection, name="LOD Meshes", description="Made by Make LOD Meshes"
    )
    build: PointerProperty(
        type=bpy.types.Collection, name="Build", description="Made by Build or Bake"
    )


def _of_first(name: str) -> property:
    """Return a Python property of the scene's settings: the setting `name` of its first crowd."""
    return property(
        lambda settings: getattr(first_crowd(settings), name),
        lambda settings, value: setattr(first_crowd(settings), name, value),
    )


for _name in CROWD_NAMES:
    setattr(CrowdLodSettings, _name, _of_first(_name))


def property_of(name: str) -> Any:
    """Return Blender's property of a setting, of the scene or of each of its crowds."""
    kind: Any = CrowdLodCrowd if name in CROWD_NAMES else CrowdLodSettings
    return kind.bl_rna.properties[name]


CLASSES = (CrowdLodCrowd, CrowdLodAction, CrowdLodGroup, CrowdLodSettings)
