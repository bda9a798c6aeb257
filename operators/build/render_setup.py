"""The render setup: one point object per bucket, which instances characters.

Geometry nodes put the instances on the points.
"""

from collections.abc import Generator, Iterator
from contextlib import suppress

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Cast
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import number as figure
from ...crowd_lod.progress import Workload
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import provenance, removal, scene_data, stored_values
from ..blender.materials import images_of
from ..blender.ownership import OWNED, remove_owned
from ..freshness.artifacts import to_make_again
from ..freshness.bake_frames import BAKED, CAMERAS, LIGHTS, is_bake
from ..lods.make_lods import TINTS
from ..scene.characters.character_provenance import character_inputs, reading
from ..scene.characters.stored_groups import groups_of
from ..scene.scene_crowd import SceneCrowd, check_levels
from ..settings.crowds import check_stored
from . import change_detection
from .change_detection import named_by, shown_by
from .character_images import IMAGE_BYTES, describe_images, image_bytes
from .nodes import baked, instances, trees
from .phase_characters import BuiltCharacters, Selection, make_characters, meshes_of_plan
from .shelves import (
    KIND,
    LEVEL,
    REMEDY,
    Bucket,
    buckets_of,
    fill_shelves,
    points_of,
    shelves_in,
    shelves_of,
)
from .visibility import unhide_characters

# Custom properties of the build's collection.
LOD_SIZES = "crowd_lod_lod_sizes"  # see lod_sizes
POSED = "crowd_lod_posed"  # see Cast
PLAYED = "crowd_lod_played"  # see change_detection.played_numbers
ACTIONS = "crowd_lod_actions"  # see change_detection.played_actions
NOTES = "crowd_lod_notes"  # sentences on what the build does not show


def cast_of(top: bpy.types.Collection, trajectory: Trajectory) -> Cast:
    """Return the Cast of characters that the point objects of the build `top` instance.

    CrowdError if the build's rigs play otherwise than agents of `trajectory` do.
    """
    is_played = np.ravel(top.get(PLAYED, [])).tolist() == change_detection.played_numbers(
        trajectory
    )
    if not is_played or top.get(ACTIONS) != change_detection.played_actions(trajectory):
        raise CrowdError(
            "The agents' speeds, their actions or the frame rate have changed since the build was "
            "made: press Build again."
        )
    groups = len(trajectory.gaits.rates)
    return Cast(np.array(stored_values.read(top, POSED, int, REMEDY, (groups,), (0, np.inf))))


def lod_sizes(scene: bpy.types.Scene) -> str:
    """Return a text that tells the scene's LOD meshes from others: sizes and feet."""
    objects = (
        item
        for level in scene.crowd_lod.levels.children
        for home in level.children
        for item in home.objects
    )
    sizes = [
        f"{len(item.data.vertices)}/{len(item.data.loops)}"
        for item in objects
        if item.type == "MESH"
    ]
    return " ".join(
        [*sizes, *(f"{group.feet:.6g}" for group in groups_of(scene.crowd_lod) if group.feet)]
    )


def build(
    crowd: SceneCrowd, selection: Selection | None = None
) -> Generator[float, None, BuiltCharacters]:
    """Put point objects and their characters into a collection of the crowd's scene.

    There is one point object per bucket. What an earlier build made stays, with all that the user
    changed or added there, except the characters. These are made anew, unless nothing that they
    depend on has changed.

    selection: the characters to make; None makes all.

    Yields the progress, returns the BuiltCharacters. Closed early, it leaves the scene as it was.
    """
    scene = crowd.scene
    check_scene(crowd)
    complete = selection is None
    built = of_plan = None
    inputs = {}
    work = Workload(10 if complete else 8)
    if complete:
        yield from work.take(reading(scene))
        of_plan = yield from work.take(meshes_of_plan(crowd), 2)
        inputs = _inputs_of_characters(crowd, of_plan)
        built = _built_before(scene, inputs)
    if built is None:
        built = yield from work.take(make_characters(crowd, selection, of_plan=of_plan), 8)
    top = install(crowd, built)
    if complete:
        provenance.keep(shelves_in(top), inputs | _digest_shown(top))
        top[NOTES] = "\n".join(built.notes)
    return built


def check_scene(crowd: SceneCrowd) -> None:
    """Raise CrowdError, before any work is done, if the crowd's scene cannot be built."""
    scene_data.check_own(crowd.scene)
    check_levels(crowd)
    check_build(crowd.scene)


def _built_before(scene: bpy.types.Scene, inputs: dict[str, str]) -> BuiltCharacters | None:
    """Return the BuiltCharacters of the scene's build, without characters; None if out of date.

    inputs: see _inputs_of_characters.
    Posed meshes are always made anew.
    """
    settings = scene.crowd_lod
    top = settings.build
    if top is None or scene_data.is_shared(scene, "build"):
        return None
    home = shelves_in(top)
    if home is None or np.any(np.ravel(top.get(POSED, 1))):
        return None
    if not provenance.is_made_of(home, inputs | _digest_shown(top)):
        return None
    return BuiltCharacters(
        np.array(top[POSED], np.intp), [], notes=str(top.get(NOTES, "")).splitlines()
    )


def _inputs_of_characters(crowd: SceneCrowd, of_plan: np.ndarray | None) -> dict[str, str]:
    """Return digests of all that the characters of a build depend on, but for what it shows.

    of_plan: what meshes_of_plan returns.
    """
    levels = crowd.settings.levels.children[: crowd.policy.count]
    homes = [home for level in levels for home in level.children]
    played = (
        change_detection.played_numbers(crowd.trajectory),
        change_detection.played_actions(crowd.trajectory),
    )
    return character_inputs(crowd.scene) | {
        "the LOD meshes": named_by(homes),
        "the actions": provenance.text_digest(played),
        "the shot plan": "" if of_plan is None else provenance.text_digest(of_plan.tolist()),
        "the settings": provenance.text_digest(crowd.policy.finest),
    }


def _digest_shown(top: bpy.types.Collection) -> dict[str, str]:
    """Return the digest of what the build `top` shows, by its name."""
    return {"the build": shown_by(top)}


def install(crowd: SceneCrowd, built: BuiltCharacters) -> bpy.types.Collection:
    """Put characters and missing point objects into the build of the crowd's scene; return it."""
    upgrade()
    scene = crowd.scene
    top = _own_build(scene) or _new_build(scene)
    _describe(crowd, top, built)
    if built.collections:
        fill_shelves(scene, top, built)
    top[IMAGE_BYTES] = float(image_bytes(images_of(top.all_objects)))
    _fit_points(top, crowd.policy.count)
    dress_all(scene)
    return top


def _new_build(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return a new, empty build, linked to `scene`."""
    top = scene.crowd_lod.build = bpy.data.collections.new("Crowd LOD Build")
    top[OWNED] = True
    scene.collection.children.link(top)
    return top


def _describe(crowd: SceneCrowd, top: bpy.types.Collection, built: BuiltCharacters) -> None:
    """Store in the build which characters it shows; forget what held for those before."""
    trajectory = crowd.trajectory
    top[LOD_SIZES] = lod_sizes(crowd.scene)
    top[POSED] = built.posed.tolist()
    top[PLAYED] = change_detection.played_numbers(trajectory)
    top[ACTIONS] = change_detection.played_actions(trajectory)
    for key in (BAKED, CAMERAS, LIGHTS):
        top.pop(key, None)
    home = shelves_in(top)
    if home is not None:
        home.pop(provenance.MADE_OF, None)


def _fit_points(top: bpy.types.Collection, count: int) -> None:
    """Give the build a point object for each bucket, and remove those of no bucket.

    count: of LODs.
    """
    surplus = points_of(top)
    for bucket in buckets_of(count):
        points = surplus.pop(bucket, None) or _points(top, bucket)
        points[LEVEL] = bucket.level
        points[KIND] = bucket.kind.value
    removal.remove([block for points in surplus.values() for block in (points, points.data)])


def notes_on_built(crowd: SceneCrowd, built: BuiltCharacters) -> str:
    """Return sentences on how the build differs from the characters; "" if nowhere.

    Also on edited characters, and on LODs that deviate to fit in Character Memory.
    """
    sentences = [
        to_make_again(crowd.scene),
        *built.notes,
        describe_images(crowd.scene),
        *_told_of_memory(crowd.settings),
    ]
    slides = crowd.trajectory.gaits.paces.off
    if slides:
        sentences.append(
            f"The state machine has more speeds than characters have walk cycles: feet slide by "
            f"up to {slides:.0%} of the way."
        )
    return " ".join(filter(None, sentences))


def _told_of_memory(settings) -> Iterator[str]:
    """Yield sentences on what was given up so that characters fit in memory."""
    is_fitted = settings.memory == settings.memory_made and settings.memory_tolerance
    if settings.choice != "BY_TOLERANCE" or not is_fitted:
        return
    pixels = figure(settings.memory_tolerance)
    yield (
        f"To fit in {settings.memory:g} MB, LODs deviate by up to {pixels} pixels in the "
        f"frames that were looked at."
    )
    limited = [group.name for group in settings.groups if group.finest]
    if limited:
        yield (
            f"Nearer to the camera these look coarser, for their finest LODs are not built: "
            f"{', '.join(limited)}."
        )


def _own_build(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """Return the scene's build, or None.

    A linked copy of a scene refers to the build of the first scene. The build stays with the first;
    the copy forgets it here.
    """
    if scene_data.is_shared(scene, "build"):
        scene_data.let_go(scene, "build")
    return scene.crowd_lod.build


def _points(top: bpy.types.Collection, bucket: Bucket) -> bpy.types.Object:
    """Return a new point object for `bucket`."""
    mesh = bpy.data.meshes.new(f"Crowd {bucket.name} points")
    points = bpy.data.objects.new(mesh.name, mesh)
    mesh[OWNED] = points[OWNED] = True
    # instances are drawn in the object color of their instancer
    points.color = (*TINTS[bucket.level], 1.0)
    points.visible_camera = bucket.is_seen  # its instances, too
    top.objects.link(points)
    return points


def dress_all(scene: bpy.types.Scene) -> None:
    """Give the point objects of the scene's build our modifier, with its inputs."""
    top = scene.crowd_lod.build
    check_stored(scene.crowd_lod)
    inputs = {"Turn": float(scene_data.rotation(scene.crowd_lod.forward))}
    if is_bake(top):
        inputs["Rate"], inputs["Opens"], *_ = baked_of(top)
        tree = baked.baked()
    else:
        tree = instances.instances()
    shelves = shelves_of(top)
    for bucket, points in points_of(top).items():
        level = bucket.level
        if level not in shelves:
            continue
        modifier = _modifier_of(points)
        modifier.node_group = tree
        for name, value in {**inputs, "Characters": shelves[level], "LOD": level}.items():
            scene_data.set_node_input(modifier, name, value)
        points.update_tag()


def _modifier_of(points: bpy.types.Object) -> bpy.types.Modifier:
    """Return our modifier of a point object, a new one if it has none."""
    for modifier in points.modifiers:
        if modifier.type == "NODES" and trees.is_ours(modifier.node_group):
            return modifier
    return points.modifiers.new("Crowd LOD", "NODES")


def remove_build(settings) -> None:
    """Remove the build: points, characters, rigs, and otherwise unused node groups."""
    top = _own_build(settings.id_data)
    settings.build = None
    if top is not None:
        unhide_characters(top)
        remove_owned(top)
    for kind in (baked.NAME, instances.NAME):  # the one holds the other
        tree = trees.find_tree(kind)
        if tree is not None and not tree.users:
            removal.remove([tree])


@bpy.app.handlers.persistent
def upgrade(*_) -> None:
    """Rebuild our node groups of another version in the file (load_post handler).

    The builds that use them get their inputs again, unless these are spoilt: then Build says so.
    """
    if trees.stale(instances.NAME, instances.VERSION) or trees.stale(baked.NAME, baked.VERSION):
        baked_tree = trees.find_tree(baked.NAME)
        if baked_tree is not None:
            baked_tree[trees.TREE_VERSION] = 0  # it holds the other, whose sockets are new
        instances.instances()
        if baked_tree is not None:
            baked.baked()
        for scene in bpy.data.scenes:
            with suppress(CrowdError):
                if scene.crowd_lod.build is not None:
                    dress_all(scene)


def check_build(scene: bpy.types.Scene) -> None:
    """Raise CrowdError if our data in the scene's build cannot be read."""
    top = scene.crowd_lod.build
    if top is not None:
        points_of(top), shelves_of(top)
        if is_bake(top):
            baked_of(top)


def baked_of(top: bpy.types.Collection) -> list[float]:
    """Return Rate, Opens, first and last frame of the baked build `top`."""
    return stored_values.read(top, BAKED, float, REMEDY, (4,))
