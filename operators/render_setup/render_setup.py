"""The render setup: one point object per bucket, which instances characters.

Geometry nodes put the instances on the points.
"""

from collections.abc import Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Gaits, Library
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import number as figure
from ...crowd_lod.levels.assignment import MOST_LEVELS
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data, stored_values
from ..blender.collection_caches import note_change, note_held
from ..blender.ownership import OWNED, remove_owned
from ..characters.stored_groups import groups_of
from ..lod_meshes.made_for import to_make_again
from ..lod_meshes.make_lods import TINTS
from ..scene.scene_crowd import home_of, policy_of, trajectory_of
from . import played_by
from .change_detection import made_of, shown_by
from .hidden_characters import unhide_characters
from .nodes import baked, instances, trees
from .phase_characters import Cast, Wanted, make_cast
from .view_layers import exclude, show_where_characters_are

# Custom properties. Of a point object: its LOD and its bucket; in builds from before there were
# rigs its poses, and their rates.
LEVEL, BUCKET, OLD_POSES, OLD_RATES = "crowd_lod_level", "crowd_lod_bucket", "crowd_lod_poses", "crowd_lod_rates"
# of the collection of all characters, and of a LOD's collection in it
LIBRARY = "crowd_lod_library"
RIGS = "crowd_lod_rigs"  # of the collection of all rigs in that
MADE_FROM = "crowd_lod_made_from"  # of the build's collection: the LOD meshes that it shows
# of the build's collection: see Library, and played_by.numbers
POSED, PLAYED = "crowd_lod_posed", "crowd_lod_played"
ACTIONS = "crowd_lod_actions"  # of the build's collection: see played_by.actions
# of the build's collection: see _made_of; what it does not show
MADE_OF, NOTES = "crowd_lod_made_of", "crowd_lod_notes"
# of the build's collection: Rate and Opens (render_setup/nodes/baked.py), the first and the last frame
BAKED = "crowd_lod_baked"
CAMERAS, LIGHTS = "crowd_lod_cameras", "crowd_lod_lights"  # of a bake: digests for each frame

REMEDY = "press Remove Build, then Build again"  # where one of these is spoilt

UNSEEN_BY = {"LOD": (), "Shadow": ("camera",), "Mirror": ("camera",)}  # kinds of buckets


def library_of(top: bpy.types.Collection, points: bpy.types.Object, gaits: Gaits) -> Library:
    """Return the Library of characters that a point object instances.

    top: the build.
    points: its point object.
    gaits: how the groups play their actions.
    """
    groups = len(gaits.rates)
    if POSED in top:
        return Library(np.array(stored_values.read(top, POSED, int, REMEDY, (groups,), (0, np.inf))))
    if OLD_POSES not in points:  # from before there were poses
        return Library(np.ones(groups, np.intp))
    rates = np.ones((groups, 1))
    if OLD_RATES in points:
        rates = np.array(stored_values.read(points, OLD_RATES, float, REMEDY, range(groups, 4 * groups + 1, groups))).reshape(
            groups, -1
        )
    return Library(
        np.array(stored_values.read(points, OLD_POSES, int, REMEDY, (groups,), (1, np.inf))), np.isfinite(rates).sum(axis=1)
    )


def libraries_of(
    top: bpy.types.Collection, points: dict[str, bpy.types.Object], names: Iterable[str], trajectory: Trajectory
) -> list[tuple[Library, list[str]]]:
    """Group point objects by the Library of characters that they instance.

    top: the build.
    points: its point objects by name.
    names: those to group.

    Returns [(Library, names)]. CrowdError if the build's rigs play otherwise than agents of
    `trajectory` do.
    """
    names, gaits = list(names), trajectory.gaits
    if PLAYED in top and (
        np.ravel(top[PLAYED]).tolist() != played_by.numbers(trajectory) or top.get(ACTIONS, "") != played_by.actions(trajectory)
    ):
        raise CrowdError(
            "The agents' speeds, their actions or the frame rate have changed since the build was made: press Build again."
        )
    if POSED in top:
        return [(library_of(top, points[names[0]], gaits), names)] if names else []
    return [(library_of(top, points[name], gaits), [name]) for name in names]


@dataclass(frozen=True)
class Bucket:
    """A point object of the build.

    name: unique in the build.
    level: the LOD that it shows.
    unseen_by: the rays that do not see it, of camera, shadow, diffuse, glossy, transmission and
        volume_scatter (Object.visible_...).
    """

    name: str
    level: int
    unseen_by: tuple[str, ...] = ()


def buckets_of(scene: bpy.types.Scene) -> list[Bucket]:
    """Return the buckets that a build of `scene` has.

    One per LOD for the agents that the camera sees, and one per LOD for those of which it sees only
    the shadow or only the reflection. The latter are hidden from camera rays and from no others:
    Cycles also counts what a surface scatters toward a lamp as the lamp's light.
    """
    count = policy_of(scene.crowd_lod).count
    return [Bucket(f"{name} {k}", k, hidden) for name, hidden in UNSEEN_BY.items() for k in range(count)]


def check_levels(scene: bpy.types.Scene) -> int:
    """Return the number of LODs; CrowdError if LOD meshes do not fit the settings."""
    settings = scene.crowd_lod
    if settings.levels is None:
        raise CrowdError(f"The scene {scene.name} has no LOD meshes: press Make LOD Meshes in the Levels of Detail panel.")
    levels, count = settings.levels.children, policy_of(settings).count
    made = len(levels[0].children) if levels else 0
    if len(levels) < count or made != len(settings.groups):
        raise CrowdError(
            f"The LOD meshes of {scene.name} ({len(levels)} LODs of {made} character groups) do not fit the settings "
            f"({count} of {len(settings.groups)}): press Make LOD Meshes and Build again."
        )
    for level in levels[:count]:
        for g, group in enumerate(settings.groups):
            home_of(level, g, group.name)
    return count


def made_from(scene: bpy.types.Scene) -> str:
    """Return a text that tells the scene's LOD meshes from others: sizes and feet."""
    objects = (item for level in scene.crowd_lod.levels.children for home in level.children for item in home.objects)
    sizes = [f"{len(item.data.vertices)}/{len(item.data.loops)}" for item in objects if item.type == "MESH"]
    return " ".join([*sizes, *(f"{group.feet:.6g}" for group in groups_of(scene.crowd_lod) if group.feet)])


def build(scene: bpy.types.Scene, wanted: Wanted | None = None) -> Generator[float, None, Cast]:
    """Put the point objects and their characters into a collection of the scene.

    One point object per bucket. wanted: the characters to make; None makes all.

    What an earlier build made stays, with all that the user changed or added there, except the
    characters. These are made anew, unless nothing that they depend on has changed.

    Yields the progress and returns the Cast. Closed early, it leaves the scene as it was.
    """
    scene_data.check_own(scene)
    check_levels(scene)
    check_build(scene)
    cast = None if wanted is not None else _as_it_is(scene)
    if cast is None:
        cast = yield from make_cast(scene, scene.crowd_lod, wanted)
    top = install(scene, cast)
    if wanted is None:
        top[MADE_OF], top[NOTES] = _made_of(scene, top), "\n".join(cast.notes)
    return cast


def _made_of(scene: bpy.types.Scene, top: bpy.types.Collection) -> str:
    """Return hashes that change when the build's characters must be made anew."""
    levels = scene.crowd_lod.levels.children
    homes = [home for level in levels[: policy_of(scene.crowd_lod).count] for home in level.children]
    played = played_by.inputs(homes, trajectory_of(scene))
    return f"{made_of(homes, played)} {policy_of(scene.crowd_lod).finest} {scene.crowd_lod.scale_textures} {shown_by(top)}"


def _as_it_is(scene: bpy.types.Scene) -> Cast | None:
    """Return the Cast of the scene's build, without characters, if it is up to date.

    None if they are not. Posed meshes and scaled images are always made anew.
    """
    top = scene.crowd_lod.build
    if (
        top is None
        or scene.crowd_lod.scale_textures
        or scene_data.shared(scene, "build")
        or MADE_OF not in top
        or np.any(np.ravel(top.get(POSED, 1)))
    ):
        return None
    if top[MADE_OF] != _made_of(scene, top):
        return None
    return Cast(np.array(top[POSED], np.intp), [], notes=str(top.get(NOTES, "")).splitlines())


def install(scene: bpy.types.Scene, cast: Cast) -> bpy.types.Collection:
    """Put characters and missing point objects into the scene's build; return it."""
    settings = scene.crowd_lod
    upgrade()
    top = _own(scene)
    if top is None:
        top = settings.build = bpy.data.collections.new("Crowd LOD Build")
        top[OWNED] = True
        scene.collection.children.link(top)
    top[MADE_FROM], top[POSED], top[PLAYED] = made_from(scene), cast.posed.tolist(), played_by.numbers(trajectory_of(scene))
    top[ACTIONS] = played_by.actions(trajectory_of(scene))
    for key in (BAKED, CAMERAS, LIGHTS, MADE_OF):
        top.pop(key, None)
    if cast.collections:
        _shelve(scene, top, cast)
    made = points_of(top)
    for bucket in buckets_of(scene):
        points = made.pop(bucket.name, None) or _points(top, bucket)
        points[LEVEL], points[BUCKET] = bucket.level, bucket.name
        for key in (OLD_POSES, OLD_RATES):
            points.pop(key, None)
    bpy.data.batch_remove([block for points in made.values() for block in (points, points.data)])
    dress_all(scene)
    return top


def told_of_cast(scene: bpy.types.Scene, cast: Cast) -> str:
    """Return sentences on how the build differs from the characters; "" if nowhere.

    Also on edited characters, and on LODs that deviate to fit in Memory for Characters.
    """
    found = [*filter(None, [to_make_again(scene)]), *cast.notes]
    settings, slides = scene.crowd_lod, trajectory_of(scene).gaits.paces.off
    limited = [group.name for group in settings.groups if group.finest]
    if settings.choice == "BY_TOLERANCE" and settings.memory == settings.memory_made and settings.memory_tolerance:
        pixels = figure(settings.memory_tolerance)
        found.append(f"To fit in {settings.memory:g} MB, LODs deviate by up to {pixels} pixels in the frames that were looked at.")
        if limited:
            found.append(f"Nearer to the camera these look coarser, for their finest LODs are not built: {', '.join(limited)}.")
    if slides:
        found.append(
            f"The state machine has more speeds than characters have walk cycles: feet slide by up to {slides:.0%} of the way."
        )
    return " ".join(found)


def _own(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """Return the scene's build, or None.

    A linked copy of a scene begins with the build of the other scene, which keeps it: here the copy
    lets it go.
    """
    if scene_data.shared(scene, "build"):
        scene_data.let_go(scene, "build")
    return scene.crowd_lod.build


def _points(top: bpy.types.Collection, bucket: Bucket) -> bpy.types.Object:
    """Return a new point object for `bucket`."""
    mesh = bpy.data.meshes.new(f"Crowd {bucket.name} points")
    points = bpy.data.objects.new(mesh.name, mesh)
    mesh[OWNED] = points[OWNED] = True
    # instances are drawn in the object color of their instancer
    points.color = (*TINTS[bucket.level], 1.0)
    for ray in bucket.unseen_by:
        setattr(points, f"visible_{ray}", False)  # their instances, too
    top.objects.link(points)
    return points


def dress_all(scene: bpy.types.Scene) -> None:
    """Give the point objects of the scene's build our modifier, with its inputs.

    A build from before there were poses shows each group's LOD itself, as it did then.
    """
    top, levels = scene.crowd_lod.build, scene.crowd_lod.levels
    stored_values.check(scene.crowd_lod)
    inputs = {"Turn": float(scene_data.rotation(scene.crowd_lod.forward))}
    if BAKED in top:
        inputs["Rate"], inputs["Opens"], *_ = baked_of(top)
        tree = baked.baked()
    else:
        tree = instances.instances()
    shelves = _shelves(top)
    for points in points_of(top).values():
        level = _level(points, LEVEL)
        if level not in shelves and (levels is None or level >= len(levels.children)):
            continue
        modifier = next((m for m in points.modifiers if m.type == "NODES" and trees.is_ours(m.node_group)), None)
        modifier = modifier or points.modifiers.new("Crowd LOD", "NODES")
        modifier.node_group = tree
        characters = shelves[level] if level in shelves else levels.children[level]
        for name, value in {**inputs, "Characters": characters}.items():
            scene_data.set_node_input(modifier, name, value)
        points.update_tag()


def _shelve(scene: bpy.types.Scene, top: bpy.types.Collection, cast: Cast) -> None:
    """Put the characters into the build, in place of those that it has."""
    library = _library_of(top)
    if library is None:
        library = _library(top, "Crowd LOD Characters", LIBRARY, -1)
        # else a view layer that the user adds later would show them
        library.hide_render = library.hide_viewport = True
        for view_layer in scene.view_layers:
            view_layer.update()  # a scene that was never evaluated has no layer collections yet
            exclude(view_layer.layer_collection, library)
        show_where_characters_are(scene)
    shelves, levels = _shelves(top), len(cast.collections)
    gone, spare = bpy.data.collections.new("Crowd LOD"), {}
    # what the user put into characters is to stay in this scene
    scene.collection.children.link(gone)
    for level, shelf in list(shelves.items()):
        spare[level] = _emptied(shelf, gone)
        if level >= levels:
            gone.children.link(shelves.pop(level))
    for level, characters in enumerate(cast.collections):
        if level not in shelves:
            shelves[level], spare[level] = _library(library, f"Crowd LOD {level} characters", LIBRARY, level), []
        for home in spare[level][len(characters) :]:
            shelves[level].children.unlink(home)
            gone.children.link(home)
    rigs = next((child for child in library.children if RIGS in child), None) or _library(library, "Crowd LOD Rigs", RIGS, True)
    for rig in [item for item in rigs.objects if item.get(OWNED)]:
        rigs.objects.unlink(rig)
        gone.objects.link(rig)
    remove_owned(gone)
    for rig in cast.rigs:
        rigs.objects.link(rig)
    for level, characters in enumerate(cast.collections):
        _fill(shelves[level], spare[level][: len(characters)], characters)
    note_change(top, library, rigs, *shelves.values())
    for block, name in cast.names.items():
        block.name = name
    note_held(rigs, *shelves.values(), *(home for shelf in shelves.values() for home in shelf.children))


def _fill(shelf: bpy.types.Collection, homes: list[bpy.types.Collection], characters: list[tuple[str, list]]) -> None:
    """Put `characters`, (name, objects) each, into `shelf`: first into its emptied `homes`."""
    for home in homes:
        home.name = "Crowd LOD character"  # none keeps what another is to be called
    for number, (name, items) in enumerate(characters):
        home = homes[number] if number < len(homes) else bpy.data.collections.new(name)
        home.name, home[OWNED] = name, True
        for item in items:
            home.objects.link(item)
        if number >= len(homes):
            shelf.children.link(home)


def _emptied(shelf: bpy.types.Collection, gone: bpy.types.Collection) -> list[bpy.types.Collection]:
    """Move the characters in `shelf` to `gone`, and return their emptied collections.

    The collections are reused, because Blender takes seconds to remove thousands. A collection into
    which the user has put something goes to `gone` as it is.
    """
    left = []
    for home in list(shelf.children):
        if home.get(OWNED) and not home.children and all(item.get(OWNED) for item in home.objects):
            for item in list(home.objects):
                # a group's last LOD may stand in place of another, too
                if gone.objects.get(item.name) is None:
                    gone.objects.link(item)
                home.objects.unlink(item)
            left.append(home)
        else:
            shelf.children.unlink(home)
            gone.children.link(home)
    return left


def _library(parent: bpy.types.Collection, name: str, key: str, level: int) -> bpy.types.Collection:
    made = bpy.data.collections.new(name)
    made[OWNED], made[key] = True, level
    parent.children.link(made)
    return made


def _library_of(top: bpy.types.Collection) -> bpy.types.Collection | None:
    """Return the collection of all characters of the build `top`."""
    return next((child for child in top.children if LIBRARY in child), None)


def remove_build(settings) -> None:
    """Remove the build: points, characters, rigs, and otherwise unused node groups."""
    top, settings.build = _own(settings.id_data), None
    if top is not None:
        unhide_characters(top)
        remove_owned(top)
    for kind in (baked.NAME, instances.NAME):  # the one holds the other
        tree = trees.made(kind)
        if tree is not None and not tree.users:
            bpy.data.node_groups.remove(tree)


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """Rebuild our node groups of another version in the file (load_post handler).

    The builds that use them get their inputs again, unless these are spoilt: then Build says so.
    """
    if trees.stale(instances.NAME, instances.VERSION) or trees.stale(baked.NAME, baked.VERSION):
        both = trees.made(baked.NAME)
        if both is not None:
            both[trees.TREE_VERSION] = 0  # it holds the other, whose sockets are new
        instances.instances()
        if both is not None:
            baked.baked()
        for scene in bpy.data.scenes:
            with suppress(CrowdError):
                if scene.crowd_lod.build is not None:
                    dress_all(scene)


def points_of(top: bpy.types.Collection) -> dict[str, bpy.types.Object]:
    """Return the point objects of the build `top` by bucket name.

    In a file from before there were buckets, they are named by their LOD.
    """
    found = {}
    for item in top.objects:
        if LEVEL in item and item.type == "MESH":
            level = _level(item, LEVEL)
            found[stored_values.read(item, BUCKET, str, REMEDY) if BUCKET in item else f"LOD {level}"] = item
    return found


def _level(block: bpy.types.ID, key: str) -> int:
    """Return the LOD in the custom property `key` (LEVEL or LIBRARY) of a block."""
    return stored_values.read(block, key, int, REMEDY, bounds=(0, MOST_LEVELS - 1))


def check_build(scene: bpy.types.Scene) -> None:
    """Raise CrowdError if our data in the scene's build cannot be read.

    Called before any work is done.
    """
    top = scene.crowd_lod.build
    if top is not None:
        points_of(top), _shelves(top)
        if BAKED in top:
            baked_of(top)


def baked_of(top: bpy.types.Collection) -> list[float]:
    """Return Rate, Opens, first and last frame of the baked build `top`."""
    return stored_values.read(top, BAKED, float, REMEDY, (4,))


def _shelves(top: bpy.types.Collection) -> dict[int, bpy.types.Collection]:
    """Return the collections of characters of the build `top`, by LOD."""
    inside = [child for child in top.children_recursive if LIBRARY in child and child != _library_of(top)]
    return {_level(child, LIBRARY): child for child in inside}
