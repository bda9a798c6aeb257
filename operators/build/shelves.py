"""The collections of a build that hold its characters, and the buckets that show them."""

from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.levels.assignment import MOST_LEVELS
from ..blender import stored_values
from ..blender.collection_caches import note_change, note_held
from ..blender.ownership import OWNED, remove_owned
from .phase_characters import BuiltCharacters
from .visibility import exclude, show_where_characters_are

# Custom properties: of the collection of all characters, and of a LOD's collection in it; of the
# collection of all rigs in that.
SHELF = "crowd_lod_shelf"
RIGS = "crowd_lod_rigs"
REMEDY = "press Remove Build, then Build again"  # where a custom property of a build is spoilt


def fill_shelves(scene: bpy.types.Scene, top: bpy.types.Collection, built: BuiltCharacters) -> None:
    """Put the characters into the build, in place of those that it has."""
    shelving = shelves_in(top)
    if shelving is None:
        shelving = _shelf(top, "Crowd LOD Characters", SHELF, -1)
        # else a view layer that the user adds later would show them
        shelving.hide_render = shelving.hide_viewport = True
        for view_layer in scene.view_layers:
            view_layer.update()  # a scene that was never evaluated has no layer collections yet
            exclude(view_layer.layer_collection, shelving)
        show_where_characters_are(scene)
    shelves = shelves_of(top)
    levels = len(built.collections)
    old_characters = bpy.data.collections.new("Crowd LOD")
    spare = {}
    # what the user put into characters is to stay in this scene
    scene.collection.children.link(old_characters)
    for level, shelf in list(shelves.items()):
        spare[level] = _emptied(shelf, old_characters)
        if level >= levels:
            old_characters.children.link(shelves.pop(level))
    for level, characters in enumerate(built.collections):
        if level not in shelves:
            shelves[level] = _shelf(shelving, f"Crowd LOD {level} characters", SHELF, level)
            spare[level] = []
        for home in spare[level][len(characters) :]:
            shelves[level].children.unlink(home)
            old_characters.children.link(home)
    rigs = next((child for child in shelving.children if RIGS in child), None) or _shelf(
        shelving, "Crowd LOD Rigs", RIGS, True
    )
    for rig in [item for item in rigs.objects if item.get(OWNED)]:
        rigs.objects.unlink(rig)
        old_characters.objects.link(rig)
    remove_owned(old_characters)
    for rig in built.rigs:
        rigs.objects.link(rig)
    for level, characters in enumerate(built.collections):
        _fill(shelves[level], spare[level][: len(characters)], characters)
    note_change(top, shelving, rigs, *shelves.values())
    for block, name in built.names.items():
        block.name = name
    note_held(
        rigs, *shelves.values(), *(home for shelf in shelves.values() for home in shelf.children)
    )


def _fill(
    shelf: bpy.types.Collection,
    homes: list[bpy.types.Collection],
    characters: list[tuple[str, list]],
) -> None:
    """Put `characters`, (name, objects) each, into `shelf`: first into its emptied `homes`."""
    for home in homes:
        home.name = "Crowd LOD character"  # none keeps what another is to be called
    for number, (name, items) in enumerate(characters):
        home = homes[number] if number < len(homes) else bpy.data.collections.new(name)
        home.name = name
        home[OWNED] = True
        for item in items:
            home.objects.link(item)
        if number >= len(homes):
            shelf.children.link(home)


def _emptied(
    shelf: bpy.types.Collection, old_characters: bpy.types.Collection
) -> list[bpy.types.Collection]:
    """Move the characters in `shelf` to `old_characters`, and return their emptied collections.

    The collections are reused, because Blender takes seconds to remove thousands. A collection into
    which the user has put something goes to `old_characters` as it is.
    """
    left = []
    for home in list(shelf.children):
        if home.get(OWNED) and not home.children and all(item.get(OWNED) for item in home.objects):
            for item in list(home.objects):
                # a group's last LOD may stand in place of another, too
                if old_characters.objects.get(item.name) is None:
                    old_characters.objects.link(item)
                home.objects.unlink(item)
            left.append(home)
        else:
            shelf.children.unlink(home)
            old_characters.children.link(home)
    return left


def _shelf(parent: bpy.types.Collection, name: str, key: str, level: int) -> bpy.types.Collection:
    shelf = bpy.data.collections.new(name)
    shelf[OWNED] = True
    shelf[key] = level
    parent.children.link(shelf)
    return shelf


def shelves_in(top: bpy.types.Collection) -> bpy.types.Collection | None:
    """Return the collection of all characters of the build `top`."""
    return next((child for child in top.children if SHELF in child), None)


def shelves_of(top: bpy.types.Collection) -> dict[int, bpy.types.Collection]:
    """Return the collections of characters of the build `top`, by LOD."""
    inside = [
        child for child in top.children_recursive if SHELF in child and child != shelves_in(top)
    ]
    return {level_of(child, SHELF): child for child in inside}


def level_of(block: bpy.types.ID, key: str) -> int:
    """Return the LOD in the custom property `key` of a block."""
    return stored_values.read(block, key, int, REMEDY, bounds=(0, MOST_LEVELS - 1))


# Custom properties of a point object.
LEVEL = "crowd_lod_level"  # the LOD that it shows
KIND = "crowd_lod_kind"  # the kind of its bucket


class BucketKind(StrEnum):
    """Whom a bucket shows.

    LOD: agents that the camera sees. SHADOW, MIRROR: those of whom it sees only the shadow, or what
    they take of the sky's light, only the reflection.
    """

    LOD = "LOD"
    SHADOW = "Shadow"
    MIRROR = "Mirror"


class Bucket(NamedTuple):
    """The agents of a kind that show the LOD `level`."""

    kind: BucketKind
    level: int

    @property
    def name(self) -> str:
        return f"{self.kind} {self.level}"

    @property
    def is_seen(self) -> bool:
        """Whether the camera sees its agents themselves."""
        return self.kind is BucketKind.LOD


def buckets_of(count: int) -> list[Bucket]:
    """Return the buckets that a build of so many LODs has: one per kind and LOD.

    Those that are not seen are hidden from camera rays and from no others: Cycles also counts what
    a surface scatters toward a lamp as the lamp's light.
    """
    return [Bucket(kind, level) for kind in BucketKind for level in range(count)]


def members(frame: Frame) -> dict[Bucket, np.ndarray]:
    """Return the agents (m,) intp of each bucket of the frame."""
    agents_of = {
        BucketKind.LOD: frame.buckets,
        BucketKind.SHADOW: frame.shadow,
        BucketKind.MIRROR: frame.mirrored,
    }
    nobody = np.empty(0, np.intp)
    return {
        bucket: nobody if agents_of[bucket.kind] is None else agents_of[bucket.kind][bucket.level]
        for bucket in buckets_of(len(frame.buckets.counts))
    }


def points_in(top: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """Yield the point objects of the build `top`, even if our data in it is spoilt."""
    for item in top.objects:
        if LEVEL in item and item.type == "MESH":
            yield item


def points_of(top: bpy.types.Collection) -> dict[Bucket, bpy.types.Object]:
    """Return the point objects of the build `top` by bucket; CrowdError if one is spoilt."""
    return {bucket_of(item): item for item in points_in(top)}


def bucket_of(points: bpy.types.Object) -> Bucket:
    """Return the bucket that a point object of a build shows."""
    level = level_of(points, LEVEL)
    text = stored_values.read(points, KIND, str, REMEDY)
    try:
        return Bucket(BucketKind(text), level)
    except ValueError:
        raise CrowdError(
            f'The custom property "{KIND}" of {points.name} is {text!r}, and must be '
            f"{', '.join(BucketKind)}: {REMEDY}."
        ) from None
