"""What of a selection is a character: rigs with their meshes, loose parts, LODs, instances."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import bpy
import numpy as np

from ...crowd_lod.format import counted
from ..blender.character_objects import GEOMETRY, may_have_faces
from ..blender.ownership import OWNED
from .given_lods import CharacterGroup, label_of, with_given_lods

FLAT = 4.0  # times as wide as high: ground, and no person


def characters_in(
    scene: bpy.types.Scene, selected: Sequence[bpy.types.Object]
) -> dict[bpy.types.Object, list[bpy.types.Object]]:
    """Return the characters that `selected` belong to: root -> the root and all its shapes.

    A root is a rig. Its shapes are what it deforms and what is parented to it. Shapes that no rig
    moves have as root the topmost shape, or selected empty, that they are parented to. Empties
    above all these, with no shape of others below them, come last.
    """
    shapes = {
        bone.custom_shape
        for item in scene.objects
        if item.type == "ARMATURE"
        for bone in item.pose.bones
    }
    usable = [item for item in scene.objects if item not in shapes and is_shape(item)]
    empties = {
        item for item in selected if item.type == "EMPTY" and item.instance_collection is None
    }
    root = {item: _root(item, empties) for item in usable}
    roots = {item if item.type in ("ARMATURE", "EMPTY") else root.get(item) for item in selected}
    # a selected empty brings what is below it
    roots |= {
        root[item] for item in usable if empties.intersection(_parents(item) + _parents(root[item]))
    }
    members: dict[bpy.types.Object, list[bpy.types.Object]] = {}
    for item in usable:
        if root[item] in roots:
            members.setdefault(root[item], [root[item]]).append(item)
    return {
        top: list(dict.fromkeys([*items, *_empties_above(items, usable)]))
        for top, items in members.items()
    }


@dataclass(frozen=True)
class Reading:
    """What a selection is understood as.

    characters: root -> it and all its shapes, as characters_in; LODs of one are apart.
    instanced: collection -> an empty that shows it: each is a character.
    """

    characters: dict[bpy.types.Object, list[bpy.types.Object]]
    instanced: dict[bpy.types.Collection, bpy.types.Object]

    def groups(self) -> list[CharacterGroup]:
        """Return `characters`, the LODs of one together."""
        return with_given_lods(
            [(root, items, (0, 0, 0)) for root, items in self.characters.items()]
        )

    def lines(self) -> Iterator[str]:
        """Yield a line for each character: its name, and what it is made of."""
        for group in self.groups():
            rigs = sum(item.type == "ARMATURE" for item in group.members)
            parts = [
                counted(sum(map(is_shape, group.members)), "mesh", "meshes"),
                *[counted(rigs, "rig")] * bool(rigs),
                *[counted(len(group.lods), "LOD of its own", "LODs of its own")] * bool(group.lods),
            ]
            yield f"{group.owner.name}: {', '.join(parts)}"
        for home in self.instanced:
            yield f"{home.name}: " + (
                "linked, as a library override"
                if home.library
                else "a collection that is instanced"
            )


def read_selection(
    scene: bpy.types.Scene, selected: Sequence[bpy.types.Object], how: str = "LISTED"
) -> Reading:
    """Return how a selection is understood; how: LISTED, ONE or EACH, see the operator."""
    instanced = {
        item.instance_collection: item
        for item in selected
        if item.type == "EMPTY"
        and item.instance_collection is not None
        and any(map(is_shape, item.instance_collection.all_objects))
    }
    characters = characters_in(scene, selected)
    if how == "ONE" and characters:
        size = {root: math.prod(_box(items).size) for root, items in characters.items()}
        largest = max(characters, key=lambda root: (root.type == "ARMATURE", size[root]))
        together = dict.fromkeys(item for items in characters.values() for item in items)
        characters = {largest: list(together)}
    elif how == "LISTED":
        characters = _with_loose_parts_joined(characters)
    return Reading(characters, instanced)


def _empties_above(
    items: Sequence[bpy.types.Object], shapes: Iterable[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return the empties that `items` alone of all `shapes` are parented to, such as importers
    make.
    """
    other_shapes = set(shapes).difference(items)
    above = dict.fromkeys(
        parent for item in items for parent in _parents(item) if parent.type == "EMPTY"
    )
    movable = (
        empty for empty in above if empty.instance_collection is None and not is_fixed(empty)
    )
    return [empty for empty in movable if other_shapes.isdisjoint(empty.children_recursive)]


def is_shape(item: bpy.types.Object) -> bool:
    return item.type in GEOMETRY and may_have_faces(item) and not item.get(OWNED)


def _parents(item: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the parent of `item`, that one's parent, and so on."""
    return [] if item.parent is None else [item.parent, *_parents(item.parent)]


def _root(item: bpy.types.Object, empties: Iterable[bpy.types.Object]) -> bpy.types.Object:
    """Return the root of the character that the shape `item` belongs to; see characters_in."""
    above = [item, *_parents(item)]
    rigs = (each if each.type == "ARMATURE" else each.find_armature() for each in above)
    tops = [each for each in above if is_shape(each) or each in empties]
    return next(filter(None, rigs), tops[-1])


class _Box(NamedTuple):
    """The box around objects, world meters."""

    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low

    def overlaps(self, other: "_Box") -> bool:
        return bool((self.low <= other.high).all() and (other.low <= self.high).all())

    def around(self, other: "_Box") -> "_Box":
        return _Box(np.minimum(self.low, other.low), np.maximum(self.high, other.high))


def _box(items: Iterable[bpy.types.Object]) -> _Box:
    corners = [
        np.array(item.bound_box) @ np.array(item.matrix_world)[:3, :3].T
        + np.array(item.matrix_world.translation)
        for item in items
        if is_shape(item)
    ]
    points = np.concatenate(corners)
    return _Box(points.min(axis=0), points.max(axis=0))


def _with_loose_parts_joined(
    characters: dict[bpy.types.Object, list[bpy.types.Object]],
) -> dict[bpy.types.Object, list[bpy.types.Object]]:
    """Return the characters, those without a rig that lie in one another as one.

    Ground under them stays apart: together they would be FLAT. So do LODs, which have numbers.
    """
    loose = {
        root: items
        for root, items in characters.items()
        if not any(item.type == "ARMATURE" for item in items)
        and all(label_of(item.name).number is None for item in items)
    }
    boxes = {root: _box(items) for root, items in loose.items()}
    joined = dict(characters)
    clusters: list[bpy.types.Object] = []
    for root in sorted(loose, key=lambda root: -math.prod(boxes[root].size)):
        for first in clusters:
            around_both = boxes[first].around(boxes[root])
            if (
                boxes[first].overlaps(boxes[root])
                and around_both.size[:2].max() <= FLAT * around_both.size[2]
            ):
                joined[first] = list(dict.fromkeys([*joined[first], *joined.pop(root)]))
                boxes[first] = around_both
                break
        else:
            clusters.append(root)
    return joined


def is_fixed(item: bpy.types.Object) -> bool:
    """Return whether the object is in a collection that it cannot be taken from."""
    return any(home.library or home.override_library for home in item.users_collection)
