"""Settings of the step Crowd, with its walls, areas and goals, and of what the camera culls."""

import bpy

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ..blender.character_objects import is_scenery
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
from .setting_changes import outdate, settings_changed


class CrowdLodArea(bpy.types.PropertyGroup):
    """Meshes that lay a label over the label map, called `name`."""

    use: BoolProperty(
        update=settings_changed("areas"),
        name="Use",
        default=True,
        description="Apply the area",
    )
    object: PointerProperty(
        update=settings_changed("areas"),
        type=bpy.types.Object,
        name="Object",
        poll=lambda _, candidate: is_scenery(candidate),
        description="The label lies where this object is, seen from above",
    )
    collection: PointerProperty(
        update=settings_changed("areas"),
        type=bpy.types.Collection,
        name="Collection",
        description="The label lies where these objects are, seen from above",
    )
    label: StringProperty(
        update=settings_changed("areas"), name="Label", description="Label that lies over the map"
    )


def may_be_goal(item: bpy.types.Object) -> bool:
    """Return whether people can walk to the object."""
    return item.type == "EMPTY" or is_scenery(item)


class CrowdLodGoal(bpy.types.PropertyGroup):
    """Where people of a simulation walk to, called `name`: an object, or an area of the map."""

    object: PointerProperty(
        type=bpy.types.Object,
        name="Object",
        poll=lambda _, candidate: may_be_goal(candidate),
        description="People walk to this object: under a mesh, as seen from above, or within an "
        "empty's size",
    )
    label: StringProperty(
        name="Label", description="Without an object, people walk to this label of the map"
    )
    share: FloatProperty(
        name="Share",
        default=1.0,
        min=0,
        soft_max=10,
        description="Share of the people who walk to this goal, relative to the other goals",
    )
    is_exit: BoolProperty(
        name="Exit",
        default=True,
        description="People leave the scene at this goal instead of staying",
    )


CLASSES = (CrowdLodArea, CrowdLodGoal)


class CharacterSettings:
    """The characters of the crowds."""

    characters: PointerProperty(
        type=bpy.types.Collection,
        name="Characters",
        description="Collection whose children, collections or objects, are the character groups",
    )
    render_source_characters: BoolProperty(
        name="Render Source Characters",
        description="Render the source characters where they stand, in addition to the crowd",
    )
    forward: EnumProperty(
        name="Forward",
        description="Axis along which the characters face",
        items=[
            ("-Y", "-Y", "Blender's front"),
            ("Y", "+Y", "Blender's back"),
            ("X", "+X", "Right"),
            ("-X", "-X", "Left"),
        ],
    )


class CrowdSettings:
    """How many agents a crowd has, what moves them, and where."""

    use_crowd: BoolProperty(
        name="Show",
        default=True,
        description="Include the agents of this crowd in the scene; when off, their numbers stay "
        "reserved",
    )
    source: EnumProperty(
        name="Source",
        description="What moves the agents of this crowd",
        items=[
            ("MACHINE", "State Machine", "Agents walk by the state machine on the label map"),
            ("FILE", "File", "Trajectories that were recorded or simulated elsewhere"),
            ("POINTS", "Points", "Points or instances of an object, read in each frame"),
            (
                "SIMULATION",
                "Simulation",
                "People walk to goals, around walls and each other, simulated by JuPedSim",
            ),
        ],
    )
    tracks_file: StringProperty(
        name="File",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description=(
            "Trajectories: a table of text (CSV, PedPy, PeTrack), NPZ, or JuPedSim's SQLite"
        ),
    )
    tracks_columns: StringProperty(
        name="Columns",
        description="Names of the columns of a table without titles, such as frame,id,x,y; empty "
        "to use the file's titles",
    )
    tracks_unit: EnumProperty(
        name="Unit",
        description="Unit of length in the file",
        items=[
            ("AUTO", "From File", "The unit that the file names, or else meters"),
            ("M", "Meters", ""),
            ("CM", "Centimeters", ""),
            ("MM", "Millimeters", ""),
            ("FT", "Feet", ""),
        ],
    )
    tracks_rate: FloatProperty(
        name="Frame Rate",
        min=0,
        max=10_000,
        description="Frames a second of the file's frame numbers; 0 for the rate that the file "
        "names",
    )
    tracks_up: EnumProperty(
        name="Up",
        description="Axis that is up in the file; its headings are counter-clockwise from +X as "
        "seen from above",
        items=[
            ("Z", "Z", "As in Blender and in programs for pedestrians: X and Y are the ground"),
            ("Y", "Y", "Right-handed axes, as in Houdini and Maya: X and -Z are the ground"),
            ("Y_LEFT", "Y, Left-Handed", "As in Unity: X and Z are the ground"),
        ],
    )
    points: PointerProperty(
        type=bpy.types.Object,
        name="Object",
        description="Object whose points or instances are the agents. Attributes: id, group, "
        "heading, phase",
    )
    points_count: IntProperty(
        options={"HIDDEN"}, description="How many points the object had at Populate; 0 if not known"
    )
    group_names: StringProperty(
        name="Groups",
        description="Character groups that this crowd's agents are drawn from, such as Robot, "
        "Woman; all if empty",
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
    spawn_on: EnumProperty(
        update=outdate,
        name="Spawn On",
        description="Where the agents of a state machine or a simulation spawn",
        items=[
            (
                "RECTANGLE",
                "Rectangle",
                "At random on the crowd's ground, where the label map lets them",
            ),
            ("SURFACE", "Surface", "At random on the faces of an object, by its density"),
            ("GRID", "Grid", "In a grid over the crowd's ground"),
            ("CURVES", "Curves", "In rows along the curves of an object, as in a stadium"),
            ("POINTS", "Points", "On the instances, points or vertices of an object"),
        ],
    )
    spawn_object: PointerProperty(
        type=bpy.types.Object,
        name="Object",
        description="Object whose faces, curves or points the agents spawn on",
    )
    density_group: StringProperty(
        name="Vertex Group",
        description="Vertex group whose weights give the density of agents; uniform without one",
    )
    density_image: PointerProperty(
        type=bpy.types.Image,
        name="Image",
        description="Image over the object's UV map, which gives the density by its gray",
    )
    density_volumes: PointerProperty(
        type=bpy.types.Collection,
        name="Volumes",
        description="Collection of objects; agents spawn only inside their boxes",
    )
    spacing: FloatProperty(
        update=outdate,
        name="Spacing",
        min=0,
        unit="LENGTH",
        description="Distance between neighbors, which sets the number of agents; 0 takes the "
        "number from Agents",
    )
    rows: IntProperty(
        update=outdate,
        name="Rows",
        default=1,
        min=1,
        max=1000,
        description="Rows along each curve, outward from it",
    )
    row_depth: FloatProperty(
        name="Row Depth",
        default=0.9,
        min=0,
        unit="LENGTH",
        description="Distance from one row to the next: outward from a closed curve, to the left "
        "of an open one",
    )
    row_rise: FloatProperty(
        name="Row Rise", unit="LENGTH", description="Height of each row above the one before"
    )
    row_turn: FloatProperty(
        name="Turn",
        subtype="ANGLE",
        description="Angle added to where agents face: inward from a closed curve, to the right "
        "of an open one",
    )
    face: PointerProperty(
        type=bpy.types.Object,
        name="Face",
        description="Object that agents face where they spawn, such as a stage; if empty, the "
        "direction of their rows or points",
    )
    spawn_places: PointerProperty(
        type=bpy.types.Mesh,
        name="Places",
        description="Places to spawn at on an object, as Populate drew them",
    )
    seed: IntProperty(name="Seed", min=0, description="The same seed gives the same crowd")
    center: FloatVectorProperty(
        name="Center", size=3, subtype="TRANSLATION", description="Center of the crowd's ground"
    )
    size: FloatVectorProperty(
        name="Size",
        size=2,
        default=(60, 60),
        subtype="XYZ",
        unit="LENGTH",
        min=0,
        description="Width (X) and depth (Y) of the crowd's ground",
    )


class BehaviorSettings:
    """What the agents do."""

    map_image: PointerProperty(
        type=bpy.types.Image,
        name="Label Map",
        description=(
            "Label map over the ground: each pixel has the color of a label. Without one the "
            "ground is open between two edges"
        ),
    )
    areas: CollectionProperty(
        type=CrowdLodArea,
        name="Walls and Areas",
        description="Meshes that lay labels over the map; of two, the lower one counts",
    )
    areas_image: PointerProperty(
        type=bpy.types.Image,
        name="Walls and Areas Map",
        description="The labels of meshes, as they were last laid over the map",
    )
    height_image: PointerProperty(
        type=bpy.types.Image,
        name="Height Map",
        description="Heights over the ground, from the first channel; agents stand on it. If "
        "empty, the ground is level",
    )
    height_scale: FloatProperty(
        name="Height",
        default=1.0,
        unit="LENGTH",
        description="Height of the value 1 (white) above that of 0 (black)",
    )
    terrain: PointerProperty(
        type=bpy.types.Collection,
        name="Terrain",
        description="Collection of meshes that agents stand on, with any number of floors. It "
        "takes the place of a height map",
    )
    terrain_object: PointerProperty(
        type=bpy.types.Object,
        name="Terrain Object",
        description="Object that agents stand on, besides the collection or instead",
    )
    terrain_mesh: PointerProperty(
        type=bpy.types.Mesh,
        name="Ground",
        description="Faces of the terrain that one can stand on, as Populate read them",
    )
    tilt: BoolProperty(
        name="Align to Slope",
        description="Tilt agents to the slope of a height map or a terrain instead of keeping "
        "them upright",
    )
    machine: PointerProperty(
        type=bpy.types.Text,
        name="State Machine",
        description="What agents do on each label, as JSON. If empty, they walk to and fro "
        "between the edges",
    )
    first_frame: IntProperty(
        name="Start Frame",
        default=1,
        subtype="TIME",
        description=(
            "Frame at which the crowd starts to move; before it agents stand where they were "
            "populated"
        ),
    )


class SimulationSettings:
    """The simulation of people: goals, walls, how many and how fast."""

    goals: CollectionProperty(
        type=CrowdLodGoal,
        name="Goals",
        description="Goals that people walk to; if empty, the label exit",
    )
    goal_choice: EnumProperty(
        name="Goal Choice",
        description="Which goal a person walks to",
        items=[
            ("NEAREST", "Nearest", "The one that is nearest where the person starts"),
            ("SHARES", "By Share", "Drawn for each person, by the goals' shares"),
        ],
    )
    spawn_labels: StringProperty(
        name="Spawn Labels",
        description=(
            "Labels that people spawn on in a rectangle, such as platform, hall; if empty, all "
            "that the state machine allows"
        ),
    )
    wall_labels: StringProperty(
        name="Wall Labels",
        description="Labels that no one enters, such as house, pillar; if empty, the label wall",
    )
    obstacles: PointerProperty(
        type=bpy.types.Collection,
        name="Obstacles",
        description="Collection of meshes that people walk around, by their outlines half a meter "
        "above the ground",
    )
    people_a_minute: FloatProperty(
        name="People per Minute",
        min=0,
        max=100_000,
        description=(
            "Number of people who arrive each minute, until all Agents are there; 0 starts with "
            "all of them"
        ),
    )
    walking_speed: EnumProperty(
        name="Speed",
        description="Speed of a person who walks freely",
        items=[
            ("PEOPLE", "People", "1.34 m/s on average, spread as Weidmann measured it"),
            ("STRIDE", "Stride", "As fast as the character's action walks; without one as people"),
        ],
    )
    waiting_action: StringProperty(
        name="Waiting Action",
        default="idle",
        description="Action that people play while they stand. A character's name may follow it, "
        "as in idle Woman. Characters without one pause in their walk",
    )
    simulated_seconds: FloatProperty(
        name="Duration",
        default=20,
        min=0.1,
        max=36_000,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
        description="Seconds to simulate; of several crowds the longest counts",
    )
    simulation_file: StringProperty(
        name="Simulation File",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE", "HIDDEN"},
        description="Trajectories that Simulate wrote, which the crowd follows",
    )


CROWD = (CrowdSettings, BehaviorSettings, SimulationSettings)  # what each crowd of a scene has
CROWD_NAMES = tuple(name for part in CROWD for name in part.__annotations__)


class CrowdLodCrowd(*CROWD, bpy.types.PropertyGroup):
    """A crowd of a scene, called `name`."""


class CameraSettings:
    """What the camera culls."""

    margin_kind: EnumProperty(
        name="Margin",
        description=(
            "How far the camera's frustum is widened, for characters that reach into it from "
            "outside"
        ),
        items=[
            (
                "DERIVED",
                "From Bounds",
                "Widen the frustum just enough to keep every character that may touch a pixel",
            ),
            ("FIXED", "Fixed", "Widen the frustum by a fixed distance; may drop characters"),
        ],
    )
    margin: FloatProperty(
        name="Margin",
        default=1.0,
        min=0,
        unit="LENGTH",
        description="Distance by which the frustum's sides are moved out",
    )
    shadows: BoolProperty(
        name="Shadows and Reflections",
        default=True,
        description="Keep characters outside the picture whose shadows fall into it, or that "
        "mirrors show; the camera itself does not see them",
    )
    sky_light: BoolProperty(
        name="Sky Light",
        default=True,
        description="In Cycles, keep characters near the picture that block light of the sky",
    )
    mirrors: PointerProperty(
        type=bpy.types.Collection,
        name="Mirrors",
        description="Collection of flat objects that mirror the crowd",
    )
    occlusion: BoolProperty(
        name="Occlusion Culling",
        description=(
            "Skip characters that opaque meshes hide from the camera, and their shadows if hidden, "
            "too. Estimate Cost tells how much it saves"
        ),
    )
    occlusion_exclude: PointerProperty(
        type=bpy.types.Collection,
        name="Exclude from Occlusion",
        description=(
            "Collection of objects excluded from occlusion culling, such as scenery that "
            "compositing removes"
        ),
    )
