"""Characters from Selection: the characters' collection and its groups, made of what is
selected.
"""

from collections.abc import Iterable, Iterator, Sequence

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.character_objects import GEOMETRY, WITHOUT_FACES, may_have_faces
from ..blender.operator import Reporting
from ..blender.ownership import OWNED
from .characters import groups_in
from .given_lods import lods_of_one

MOST_NAMES = 6  # in a message


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
    usable = [item for item in scene.objects if item not in shapes and _is_shape(item)]
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
    movable = (empty for empty in above if empty.instance_collection is None and not _fixed(empty))
    return [empty for empty in movable if other_shapes.isdisjoint(empty.children_recursive)]


def _is_shape(item: bpy.types.Object) -> bool:
    return item.type in GEOMETRY and may_have_faces(item) and not item.get(OWNED)


def _parents(item: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the parent of `item`, that one's parent, and so on."""
    return [] if item.parent is None else [item.parent, *_parents(item.parent)]


def _root(item: bpy.types.Object, empties: Iterable[bpy.types.Object]) -> bpy.types.Object:
    """Return the root of the character that the shape `item` belongs to; see characters_in."""
    above = [item, *_parents(item)]
    rigs = (each if each.type == "ARMATURE" else each.find_armature() for each in above)
    tops = [each for each in above if _is_shape(each) or each in empties]
    return next(filter(None, rigs), tops[-1])


def _home(top: bpy.types.Collection, root: bpy.types.Object) -> bpy.types.Collection:
    """Return the collection in `top` of the group that the `root` is in, or a new one at its
    feet.
    """
    for child in top.children:
        if root in child.all_objects[:]:
            return child
    home = bpy.data.collections.new(root.name)
    home.instance_offset = root.matrix_world.translation
    if "stride" in root:
        home["stride"] = root["stride"]
    top.children.link(home)
    return home


def _move(item: bpy.types.Object, home: bpy.types.Collection, scene: bpy.types.Scene) -> None:
    """Move `item` to the collection `home` from all others of the scene; it stays where it is."""
    if item in home.all_objects[:]:
        return
    home.objects.link(item)
    for other in {scene.collection, *scene.collection.children_recursive}.intersection(
        item.users_collection
    ) - {home}:
        other.objects.unlink(item)


def _fixed(item: bpy.types.Object) -> bool:
    """Return whether the object is in a collection that it cannot be taken from."""
    return any(home.library or home.override_library for home in item.users_collection)


def _listed(objects: Iterable[bpy.types.Object]) -> str:
    names = sorted((item.name for item in objects), key=str.casefold)
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


def _notes(selected: Sequence[bpy.types.Object], characters: dict, moved: dict) -> Iterator[str]:
    """Yield sentences that name what is not moved, and what to do.

    characters: of characters_in; moved: those of them that are moved.
    """
    members = {item for items in characters.values() for item in items}
    # an empty above characters is none of them, and not left out
    left = {
        item
        for item in selected
        if item not in members and not members.intersection(item.children_recursive)
    }
    faceless = {"META", *WITHOUT_FACES}
    left |= {
        item
        for root in moved
        for item in root.children_recursive
        if item.type in faceless or item.instance_collection
    }
    instances = {item for item in left if item.instance_collection is not None}
    if left - instances:
        yield f"Left where they are: {_listed(left - instances)}."
    if instances:
        yield (
            f"Instances of collections, left until you make them real (Object > Apply): "
            f"{_listed(instances)}."
        )
    if fixed := characters.keys() - moved.keys():
        yield (
            f"Left in linked collections, which you can drag into the characters' collection: "
            f"{_listed(fixed)}."
        )


def _given_notes(scene: bpy.types.Scene, top: bpy.types.Collection, moved: dict) -> Iterator[str]:
    """Yield a sentence for each of the `moved` characters that has LODs of its own."""
    for group in groups_in(scene, top):
        if group.lods and not moved.keys().isdisjoint(group.members):
            names = [_listed(lod.objects_with_faces()) for lod in group.lods]
            yield f"LODs of {group.owner.name} that were given: {'; '.join(names)}."


class CROWDLOD_OT_characters_from_selection(Reporting, bpy.types.Operator):
    bl_description = (
        "Move the selected rigs and meshes to the crowd's characters, a collection for each rig "
        "with its meshes"
    )
    bl_idname = "crowd_lod.characters_from_selection"
    bl_label = "Characters from Selection"

    @classmethod
    def poll(cls, context) -> bool:
        cls.poll_message_set("Select the characters first: their rigs or meshes")
        return any(
            item.type in ("ARMATURE", "EMPTY", *GEOMETRY) for item in context.selected_objects
        )

    def run(self, context) -> str:
        scene = context.scene
        selected = context.selected_objects
        top = scene.crowd_lod.characters
        if top is not None and (top.library or top.override_library):
            raise CrowdError(
                f"The characters' collection {top.name} is linked from another file and cannot be "
                f"added to: clear Characters first."
            )
        context.view_layer.update()  # a script may have moved something
        characters = characters_in(scene, selected)
        moved = {root: items for root, items in characters.items() if not any(map(_fixed, items))}
        notes = list(_notes(selected, characters, moved))
        if not moved:
            raise CrowdError(
                " ".join(["Nothing selected is a rig with meshes, or a mesh with faces.", *notes])
            )
        if top is None:
            top = scene.crowd_lod.characters = bpy.data.collections.new("Characters")
        if top not in scene.collection.children_recursive:
            scene.collection.children.link(top)
        for root, items in moved.items():
            home = _home(top, root)
            for item in items:
                _move(item, home, scene)
        families = lods_of_one(list(moved.items()))
        finest = [list(moved)[family[0]] for family in families]
        many = f"{len(finest)} characters" if len(finest) > 1 else "A character"
        notes = [*_given_notes(scene, top, moved), *notes]
        return " ".join([f"{many} in the collection {top.name}: {_listed(finest)}.", *notes])


CLASSES = (CROWDLOD_OT_characters_from_selection,)
