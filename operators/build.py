"""The render set-up: points per LOD bucket, instanced by geometry nodes, that follow the frame."""

import sys
from itertools import product

import bpy
import numpy as np

from ..crowd_lod.agents import Crowd
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.frame import Frame
from ..crowd_lod.maps import HeightMap
from . import cameras, lights
from . import scene as io
from .levels import OWNED, TINTS, make_levels, remove_owned
from .nodes.instances import instances
from .operator import Reporting, Stepwise
from .populate import frame_of, policy_of, trajectory_of

LEVEL = "crowd_lod_level"  # custom property of a point object: its LOD
ROLE = "crowd_lod_role"  # custom property of a point object: the field of Frame whose buckets it shows
ROLES = ("buckets", "shadow", "mirrored")
NOBODY = np.empty(0, np.intp)


def check_levels(scene: bpy.types.Scene) -> int:
    """The number of LODs, if the scene's LOD meshes are those of its settings."""
    settings = scene.crowd_lod
    if settings.levels is None:
        raise CrowdError(f"The scene {scene.name} has no LOD meshes: press Make LOD Meshes in the LOD panel.")
    levels, count = settings.levels.children, policy_of(settings).count
    made = len(levels[0].children) if levels else 0
    if len(levels) < count or made != len(settings.groups):
        raise CrowdError(
            f"The LOD meshes of {scene.name} ({len(levels)} LODs of {made} character groups) do not fit the settings "
            f"({count} of {len(settings.groups)}): press Make LOD Meshes and Build again."
        )
    return count


def build(scene: bpy.types.Scene) -> None:
    """Put one point object a LOD into a new collection of the scene, in place of those of an earlier build; in collections
    within, more of them for agents that only cast shadows or are mirrored, which the camera itself does not see."""
    settings = scene.crowd_lod
    count = check_levels(scene)
    levels = settings.levels.children
    remove_build(settings)
    top = bpy.data.collections.new("Crowd LOD Build")
    top[OWNED] = True
    homes = {"buckets": top}
    for role in ("shadow", "mirrored"):
        homes[role] = bpy.data.collections.new(f"Crowd LOD {role}")
        top.children.link(homes[role])
    for role, k in product(ROLES, range(count)):
        mesh = bpy.data.meshes.new(f"Crowd LOD {k} {'points' if role == 'buckets' else role}")
        points = bpy.data.objects.new(mesh.name, mesh)
        mesh[OWNED] = points[OWNED] = True
        points[LEVEL], points[ROLE] = k, role
        # hidden from camera rays alone: what a surface scatters towards a lamp, Cycles counts as the lamp's light, too
        points.visible_camera = role == "buckets"
        points.color = (*TINTS[k], 1.0)  # instances are drawn in the object colour of their instancer
        modifier = points.modifiers.new("Crowd LOD", "NODES")
        modifier.node_group = instances()
        io.set_node_input(modifier, "Characters", levels[k])
        io.set_node_input(modifier, "Turn", float(io.rotation(settings.forward)))
        homes[role].objects.link(points)
    scene.collection.children.link(top)
    settings.build = top


def remove_build(settings) -> None:
    """Remove the point objects of the build."""
    top, settings.build = settings.build, None
    if top is not None:
        remove_owned(top)


def write(top: bpy.types.Collection, crowd: Crowd, frame: Frame, slopes: HeightMap | None = None) -> None:
    """Write the agents of each of the frame's buckets, as they stand in `crowd`, to its point object in the build `top`;
    with `slopes` they lean with them."""
    for points in top.all_objects:
        level = points.get(LEVEL)
        if level is not None and level < len(frame.buckets.counts):
            buckets = getattr(frame, points.get(ROLE, "buckets"))
            io.write_agents(points.data, crowd, buckets[level] if buckets is not None else NOBODY, slopes)


def empty(top: bpy.types.Collection) -> None:
    """Take all points out of the build `top`."""
    for points in top.all_objects:
        if LEVEL in points:
            points.data.clear_geometry()
            points.data.update_tag()


def shutter_frame(scene: bpy.types.Scene) -> float:
    """The frame in whose shutter the current time falls; without motion blur the time itself."""
    time = scene.frame_current + scene.frame_subframe
    if not scene.render.use_motion_blur:
        return time
    opens = {"START": 0.0, "CENTER": 0.5, "END": 1.0}[scene.render.motion_blur_position]
    # Blender's engines ask for times that a float32 has rounded
    return float(np.floor(time + opens + (-1e-4 if opens == 1.0 else 1e-4)))


def update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Show the scene's current time in its build: a pure function of frame and sub-frame.

    With motion blur every time within a frame's shutter shows that frame's buckets, at the positions of its own time:
    an agent that changed its LOD, and so its object, while the shutter is open would lose its blur.
    """
    top = scene.crowd_lod.build
    if {item.get(LEVEL) for item in top.objects} < set(range(check_levels(scene))):
        raise CrowdError(f"The build of {scene.name} lacks LODs that its settings ask for: press Build again.")
    time = scene.frame_current + scene.frame_subframe
    whole = shutter_frame(scene)
    camera = None if whole == time else cameras.camera_at(scene, whole)
    around = lights.read_surroundings(scene, depsgraph, whole)
    frame, trajectory = frame_of(scene, depsgraph, whole, camera, around), trajectory_of(scene)
    crowd = frame.crowd if whole == time else trajectory.at(time)
    slopes = trajectory.heights if scene.crowd_lod.tilt else None
    write(top, crowd, frame, slopes)


@bpy.app.handlers.persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """frame_change_post: the build follows the frame and the camera, as `depsgraph` has evaluated it."""
    if scene.crowd_lod.build is None:
        return
    try:
        update(scene, depsgraph)
    except CrowdError as error:
        # the crowd of another frame would be a wrong picture: show none, and say why
        empty(scene.crowd_lod.build)
        print(f"Crowd LOD, frame {scene.frame_current}: {error}", file=sys.stderr)


class CROWDLOD_OT_build(Stepwise, bpy.types.Operator):
    """Build the render set-up: instances of each LOD's collections that follow camera and frame"""

    bl_idname = "crowd_lod.build"
    bl_label = "Build"

    def steps(self, context):
        scene = context.scene
        depsgraph = context.evaluated_depsgraph_get()
        frame = frame_of(scene, depsgraph)
        if scene.crowd_lod.levels is None:
            yield from make_levels(scene)
        build(scene)
        update(scene, depsgraph)
        return f"{int(frame.visible.sum()):,} of {len(frame.crowd):,} agents stand in the scene."


class CROWDLOD_OT_remove_build(Reporting, bpy.types.Operator):
    """Remove the render set-up; LOD meshes and settings stay"""

    bl_idname = "crowd_lod.remove_build"
    bl_label = "Remove Build"

    def run(self, context):
        if context.scene.crowd_lod.build is None:
            raise CrowdError(f"The scene {context.scene.name} has no build to remove.")
        remove_build(context.scene.crowd_lod)
        return "The build is removed."


CLASSES = (CROWDLOD_OT_build, CROWDLOD_OT_remove_build)
