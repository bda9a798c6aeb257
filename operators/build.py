"""The render set-up: points per bucket, instanced by geometry nodes in the pose of their phase, that follow the frame."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..crowd_lod import chance
from ..crowd_lod.agents import Crowd
from ..crowd_lod.behaviour import Trajectory
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.frame import Frame
from ..crowd_lod.poses import pose_of
from . import cameras, lights
from . import scene as io
from .levels import OWNED, TINTS, make_levels, remove_owned
from .nodes import baked, instances, trees
from .operator import Reporting, Stepwise
from .populate import frame_of, policy_of, trajectory_of
from .poses import Posed, make_poses
from .threads import on_main_thread

# Custom properties. Of a point object: its LOD, its bucket, and how many poses each group has there.
LEVEL, BUCKET, POSES = "crowd_lod_level", "crowd_lod_bucket", "crowd_lod_poses"
LIBRARY = "crowd_lod_library"  # of the collection of all poses, and of a LOD's collection in it
MADE_FROM = "crowd_lod_made_from"  # of the build's collection: the LOD meshes that it poses
BAKED = "crowd_lod_baked"  # of the build's collection: Rate and Opens (nodes/baked.py), the first and the last frame

UNSEEN_BY = {"LOD": (), "Shadow": ("camera",), "Mirror": ("camera",)}  # kinds of buckets


@dataclass(frozen=True)
class Bucket:
    """A point object of the build. name: no other has it; level: the LOD that it shows; unseen_by: what does not see it,
    of camera, shadow, diffuse, glossy, transmission and volume_scatter (Object.visible_...)."""

    name: str
    level: int
    unseen_by: tuple[str, ...] = ()


def buckets_of(scene: bpy.types.Scene) -> list[Bucket]:
    """The buckets that a build of `scene` has: by LOD what the camera sees, and those of whom it sees the shadow or the
    reflection alone. They are hidden from camera rays and from no other: what a surface scatters towards a lamp, Cycles
    counts as the lamp's light, too."""
    count = policy_of(scene.crowd_lod).count
    return [Bucket(f"{name} {k}", k, hidden) for name, hidden in UNSEEN_BY.items() for k in range(count)]


def members(frame: Frame) -> dict[str, np.ndarray]:
    """The agents (m,) intp of each bucket, by its name, in the frame."""
    kinds = zip(UNSEEN_BY, (frame.buckets, frame.shadow, frame.mirrored), strict=True)
    nobody = np.empty(0, np.intp)
    return {
        f"{name} {k}": nobody if buckets is None else buckets[k]
        for name, buckets in kinds
        for k in range(len(frame.buckets.counts))
    }


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


def _made_from(scene: bpy.types.Scene) -> str:
    """What tells the scene's LOD meshes from others, at a glance."""
    objects = (item for level in scene.crowd_lod.levels.children for home in level.children for item in home.objects)
    return " ".join(f"{len(item.data.vertices)}/{len(item.data.loops)}" for item in objects)


def build(scene: bpy.types.Scene) -> Iterator[float]:
    """Put one point object a bucket, and the poses that they show, into a collection of the scene; yields the progress.

    What an earlier build made stays, with all that the user changed or added there, but for the poses: those are new,
    and returned. Closed early, it leaves the scene as it was.
    """
    check_levels(scene)
    posed = yield from make_poses(scene)
    install(scene, posed)
    return posed


def install(scene: bpy.types.Scene, posed: Posed) -> bpy.types.Collection:
    """Put the poses and, where there are none yet, point objects into the build of `scene`: its collection."""
    settings = scene.crowd_lod
    upgrade()
    top = settings.build
    if top is None:
        top = settings.build = bpy.data.collections.new("Crowd LOD Build")
        top[OWNED] = True
        scene.collection.children.link(top)
    top[MADE_FROM] = _made_from(scene)
    top.pop(BAKED, None)
    _shelve(scene, top, posed)
    made = points_of(top)
    for bucket in buckets_of(scene):
        points = made.pop(bucket.name, None) or _points(top, bucket)
        points[BUCKET], points[POSES] = bucket.name, posed.counts[:, bucket.level].tolist()
    bpy.data.batch_remove([block for points in made.values() for block in (points, points.data)])
    dress_all(scene)
    return top


def _points(top: bpy.types.Collection, bucket: Bucket) -> bpy.types.Object:
    """A new point object."""
    mesh = bpy.data.meshes.new(f"Crowd {bucket.name} points")
    points = bpy.data.objects.new(mesh.name, mesh)
    mesh[OWNED] = points[OWNED] = True
    points[LEVEL] = bucket.level
    points.color = (*TINTS[bucket.level], 1.0)  # instances are drawn in the object colour of their instancer
    for ray in bucket.unseen_by:
        setattr(points, f"visible_{ray}", False)  # their instances, too
    top.objects.link(points)
    return points


def dress_all(scene: bpy.types.Scene) -> None:
    """Give the point objects of the scene's build our modifier, with its inputs. A build from before there were poses
    shows each group's LOD itself, as it then did."""
    top, levels = scene.crowd_lod.build, scene.crowd_lod.levels
    inputs = {"Turn": float(io.rotation(scene.crowd_lod.forward))}
    if BAKED in top:
        tree, (inputs["Rate"], inputs["Opens"], *_) = baked.baked(), top[BAKED]
    else:
        tree = instances.instances()
    shelves = {child[LIBRARY]: child for child in top.children_recursive if LIBRARY in child}
    for points in points_of(top).values():
        level = points[LEVEL]
        if level not in shelves and (levels is None or level >= len(levels.children)):
            continue
        modifier = next((m for m in points.modifiers if m.type == "NODES" and trees.is_ours(m.node_group)), None)
        modifier = modifier or points.modifiers.new("Crowd LOD", "NODES")
        modifier.node_group = tree
        characters = shelves[level] if level in shelves else levels.children[level]
        for name, value in {**inputs, "Characters": characters}.items():
            io.set_node_input(modifier, name, value)
        points.update_tag()


def _shelve(scene: bpy.types.Scene, top: bpy.types.Collection, posed: Posed) -> None:
    """Put the poses into the build, in place of those that it has."""
    library = next((child for child in top.children if LIBRARY in child), None)
    if library is None:
        library = _library(top, "Crowd LOD Poses", -1)
        for view_layer in scene.view_layers:
            view_layer.update()  # a scene that was never evaluated has no layer collections yet
            _exclude(view_layer.layer_collection, library)
    shelves = {child[LIBRARY]: child for child in library.children if LIBRARY in child}
    gone = bpy.data.collections.new("Crowd LOD")
    for level, shelf in list(shelves.items()):
        for pose in list(shelf.children):
            shelf.children.unlink(pose)
            gone.children.link(pose)
        if level >= len(posed.collections):
            gone.children.link(shelves.pop(level))
    remove_owned(gone)
    for level, poses in enumerate(posed.collections):
        if level not in shelves:
            shelves[level] = _library(library, f"Crowd LOD {level} poses", level)
        for pose in poses:
            shelves[level].children.link(pose)
    for block, name in posed.names.items():
        block.name = name


def _library(parent: bpy.types.Collection, name: str, level: int) -> bpy.types.Collection:
    made = bpy.data.collections.new(name)
    made[OWNED], made[LIBRARY] = True, level
    parent.children.link(made)
    return made


def _exclude(layer: bpy.types.LayerCollection, collection: bpy.types.Collection) -> None:
    for child in layer.children:
        if child.collection == collection:
            child.exclude = True
        _exclude(child, collection)


def remove_build(settings) -> None:
    """Remove the build: points, poses, and the node groups that nothing else uses."""
    top, settings.build = settings.build, None
    if top is not None:
        remove_owned(top)
    for kind in (baked.NAME, instances.NAME):  # the one holds the other
        tree = trees.made(kind)
        if tree is not None and not tree.users:
            bpy.data.node_groups.remove(tree)


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """load_post: where the file holds our node groups in another version, rebuild them, and give the builds that use
    them their inputs."""
    if trees.stale(instances.NAME, instances.VERSION) or trees.stale(baked.NAME, baked.VERSION):
        both = trees.made(baked.NAME)
        if both is not None:
            both[trees.VERSION] = 0  # it holds the other, whose sockets are new
        instances.instances()
        if both is not None:
            baked.baked()
        for scene in bpy.data.scenes:
            if scene.crowd_lod.build is not None:
                dress_all(scene)


def columns_of(
    trajectory: Trajectory, crowd: Crowd, held: Crowd, agents: np.ndarray, counts: np.ndarray, tilt: bool
) -> dict[str, np.ndarray]:
    """The point attributes of `agents` (m,) as they stand in `crowd`, by name; see scene.write_points.

    position in metres, world space; heading, with `tilt` also pitch and roll (see HeightMap.tilt), in radians; phase;
    group; pose, an index into the poses of all groups, `counts` (G,) of each, as the phases in `held` say; looks, a
    number in [0, 1) of the agent's own for materials to vary by; and the stable id.
    """
    place = np.empty((len(agents), 3), np.float32)
    for axis, column in enumerate((crowd.x, crowd.y, crowd.z)):
        place[:, axis] = column[agents]
    heading, group = crowd.heading[agents], crowd.group[agents]
    columns = {
        "position": place,
        "heading": heading,
        "phase": crowd.phase[agents],
        "group": group.astype(np.int32),
        "pose": pose_of(held.phase[agents], group, counts),
        "looks": chance.uniform(trajectory.start.key[agents], chance.LOOKS).astype(np.float32),
        "id": agents.astype(np.int32),
    }
    if tilt and trajectory.heights is not None:
        pitch, roll = trajectory.heights.tilt(crowd.x[agents], crowd.y[agents], heading)
        columns |= {"pitch": np.float32(pitch), "roll": np.float32(roll)}
    return columns


def write(top: bpy.types.Collection, trajectory: Trajectory, frame: Frame, crowd: Crowd, tilt: bool) -> None:
    """Write the agents of the frame's buckets, as they stand in `crowd`, to the point objects of the build `top`. An
    older build, or a user, may have none for the unseen."""
    points = points_of(top)
    for name, agents in members(frame).items():
        if name not in points:
            continue
        counts = np.array(points[name].get(POSES) or [1] * len(trajectory.groups))
        io.write_points(points[name].data, columns_of(trajectory, crowd, frame.crowd, agents, counts, tilt))


def points_of(top: bpy.types.Collection) -> dict[str, bpy.types.Object]:
    """The point objects of the build `top` by bucket. (In a file from before there were buckets, by LOD.)"""
    return {item.get(BUCKET) or f"LOD {item[LEVEL]}": item for item in top.objects if LEVEL in item}


def empty(top: bpy.types.Collection) -> None:
    """Take all points out of the build `top`."""
    for points in points_of(top).values():
        points.data.clear_geometry()
        points.data.update_tag()


def shutter_frame(scene: bpy.types.Scene) -> float:
    """The frame, on the timeline, in whose shutter the current time falls; without motion blur the time itself."""
    time = scene.frame_current + scene.frame_subframe
    if not scene.render.use_motion_blur:
        return time
    return float(np.floor(time + opening(scene.render)))


def opening(render: bpy.types.RenderSettings) -> float:
    """The part of a frame by which the shutter opens before it. Blender's engines ask for times that a float32 has
    rounded: a frame's own time stays its own."""
    opens = {"START": 0.0, "CENTER": 0.5, "END": 1.0}[render.motion_blur_position] if render.use_motion_blur else 0.0
    return opens + (-1e-4 if opens == 1.0 else 1e-4)


def update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Show the scene's current time in its build: a pure function of frame and sub-frame.

    With motion blur every time within a frame's shutter shows that frame's buckets and poses, at the positions of its
    own time: an agent that changed its object, or its instance, while the shutter is open would lose its blur.
    """
    top, settings = scene.crowd_lod.build, scene.crowd_lod
    if BAKED in top:
        return
    check_levels(scene)
    trajectory = trajectory_of(scene)
    points = points_of(top)
    if {bucket.name for bucket in buckets_of(scene) if not bucket.unseen_by} - points.keys():
        raise CrowdError(f"The build of {scene.name} lacks LODs that its settings ask for: press Build again.")
    if top.get(MADE_FROM, made := _made_from(scene)) != made:
        raise CrowdError(f"The LOD meshes of {scene.name} are not those that its build shows: press Build again.")
    time, whole = io.time_of(scene), io.remapped(scene.render, shutter_frame(scene))
    if whole == time:  # a marker's camera becomes the active one only after the handlers of its frame
        film = cameras.cameras_from(scene, cameras.bound_camera(scene, whole), depsgraph)
    else:
        film = cameras.camera_at(scene, whole)
    around = lights.read_surroundings(scene, depsgraph, whole)
    frame = frame_of(scene, depsgraph, whole, film, trajectory, around)
    write(top, trajectory, frame, frame.crowd if whole == time else trajectory.at(time), settings.tilt)


@bpy.app.handlers.persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """frame_change_post: the build follows the frame and the camera, as `depsgraph` has evaluated it."""
    if scene.crowd_lod.build is None:
        return
    try:
        on_main_thread(lambda: _show(scene, depsgraph))
    except CrowdError as error:
        print(f"Crowd LOD, frame {scene.frame_current}: {error}", file=sys.stderr)


def _show(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    try:
        update(scene, depsgraph)
    except CrowdError:
        empty(scene.crowd_lod.build)  # the crowd of another frame would be a wrong picture
        raise


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
        posed = yield from build(scene)
        update(scene, context.evaluated_depsgraph_get())
        seen = f"{int(frame.visible.sum()):,} of {len(frame.crowd):,} agents stand in the scene"
        poses = f"up to {posed.counts.max()} poses a walk, where a LOD begins at most {posed.apart:.2g} pixels apart"
        return f"{seen}; {poses}." if posed.apart else f"{seen}."


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
