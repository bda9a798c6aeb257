"""Settings of the overlay in the viewport."""

from ..blender.labeled_properties import BoolProperty, EnumProperty, IntProperty

OVERLAY_COLORS = (
    ("LOD", "By LOD", "Red, green, blue from near to far"),
    ("STATE", "By State", "The colors of the state machine"),
    ("GROUP", "By Group", "One color for each character group"),
    ("REASON", "By Reason", "Why an agent is culled, or not shown at the finest LOD"),
    ("ERROR", "By Error", "How many pixels an agent's LOD may be off: green to red"),
    ("MATERIAL", "Materials", "Base color or image of the characters' own materials"),
)


class OverlaySettings:
    """How the viewport shows the crowd."""

    overlay: BoolProperty(
        name="Overlay", description="Draw the crowd in the viewport, each agent at its LOD"
    )
    overlay_mode: EnumProperty(
        name="Display As",
        description="How the overlay draws the agents",
        items=[
            (
                "MESHES",
                "LOD Meshes",
                "Every character at its LOD, each in its own phase of the action",
            ),
            ("BOXES", "Boxes", "Boxes as large as the characters, for very large crowds"),
            ("POINTS", "Points", "Points as wide as the characters, for very large crowds"),
        ],
    )
    overlay_color: EnumProperty(
        name="Overlay Color",
        description="Colors of the agents in the overlay",
        items=OVERLAY_COLORS,
    )
    overlay_camera: EnumProperty(
        name="Seen From",
        description="View that culls agents and chooses LODs in the overlay",
        items=[
            ("SCENE", "Scene Camera", "Culling and LODs are those of the scene's camera"),
            ("VIEWPORT", "Viewport", "Culling and LODs are those of each viewport's own view"),
        ],
    )
    hud: BoolProperty(
        name="Statistics",
        default=True,
        description="Show counts, times and memory over the viewport",
    )
    inset: BoolProperty(
        name="Inset From Above",
        description="Show the crowd, the camera's frustum and the LOD ranges from above in a "
        "corner",
    )
    agent: IntProperty(
        name="Agent",
        default=-1,
        min=-1,
        description="The agent that the overlay marks and describes; -1 is none",
    )
    overlay_culled: BoolProperty(
        name="Culled Agents",
        default=True,
        description="Show culled agents as faint points; of a crowd of more than 100,000 every "
        "second, third, and so on",
    )
