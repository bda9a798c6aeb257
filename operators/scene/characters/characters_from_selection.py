"""Characters from Selection: the characters' collection and its groups, of what is selected."""

import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ...blender.character_objects import GEOMETRY, WITHOUT_FACES, bone_shapes
from ...blender.labeled_properties import EnumProperty
from ...blender.operator import Reporting
from ...settings.crowds import first_crowd
from .action_choice import take_walks
from .character_place import box_of, is_shape, main_root, parents_of, place_of, root_of
from .characters import groups_in
from .given_lods import CharacterGroup, label_of, with_given_lods

FLAT = 4.0  # times as wide as high: ground, and no person


def characters_in(
    scene: bpy.types.Scene, selected: Sequence[bpy.types.Object]
) -> dict[bpy.types.Object, list[bpy.types.Object]]:
    """Return the characters that `selected` belong to: root -> the root and all its shapes.

    A root is a rig. Its shapes are what it deforms and what is parented or constrained to it.
    Shapes that no rig moves have as root the topmost shape, or selected empty, that carries them.
    Empties above and below all these, that carry no shape of others, come last.
    """
    shapes = bone_shapes(scene.objects)
    usable = [item for item in scene.objects if item not in shapes and is_shape(item)]
    empties = {
        item for item in selected if item.type == "EMPTY" and item.instance_collection is None
    }
    root = {item: root_of(item, empties) for item in usable}
    roots = {item if item.type in ("ARMATURE", "EMPTY") else root.get(item) for item in selected}
    # a selected empty brings what is below it
    roots |= {
        root[item]
        for item in usable
        if empties.intersection(parents_of(item) + parents_of(root[item]))
    }
    members: dict[bpy.types.Object, list[bpy.types.Object]] = {}
    for item in usable:
        if root[item] in roots:
            members.setdefault(root[item], [root[item]]).append(item)
    return {
        top: list(dict.fromkeys([*items, *_empties_of(items, usable)]))
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
            yield f"{name_of(group.owner, group.members)}: {', '.join(parts)}"
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
        largest = main_root(characters)
        together = dict.fromkeys(item for items in characters.values() for item in items)
        characters = {largest: list(together)}
    elif how == "LISTED":
        characters = _with_loose_parts_joined(characters)
    return Reading(characters, instanced)


def _empties_of(
    items: Sequence[bpy.types.Object], shapes: Iterable[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return the empties above and below `items`, and of no other of `shapes`.

    Importers make such: a root above a rig, and the leaves at the ends of its bones.
    """
    other_shapes = set(shapes).difference(items)
    related = dict.fromkeys(
        other for item in items for other in (*parents_of(item), *item.children_recursive)
    )
    return [
        empty
        for empty in related
        if empty.type == "EMPTY"
        and empty.instance_collection is None
        and not is_fixed(empty)
        and other_shapes.isdisjoint(empty.children_recursive)
    ]


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
    boxes = {root: box_of(items) for root, items in loose.items()}
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


MOST_NAMES = 6  # in a message
MOST_LINES = 20  # in the list of what is read
# names of rigs, and of meshes, in any file
OF_IMPORTERS = re.compile(
    r"(character|animal|human)?[ _]?(armature|rig|metarig|skeleton|root)(\.\d+)?", re.IGNORECASE
)
OF_BLENDER = ("Cube", "Sphere", "Icosphere", "Cylinder", "Plane", "Circle", "Cone", "Torus", "Mesh")


def name_of(root: bpy.types.ID, items: Sequence[bpy.types.Object]) -> str:
    """Return what a character of these objects is called: as its root, or, where that has a name
    that importers give to all, by the words that most of its meshes' names begin with.
    """
    names = [item.name for item in items if is_shape(item)]
    has_lods = any(label_of(name).number is not None for name in names)
    if has_lods or not OF_IMPORTERS.fullmatch(root.name):
        return root.name
    words = [re.findall(r"[^ _.]*[^ _.0-9][^ _.]*", name) for name in names]
    words = [each for each in words if each and each[0] not in OF_BLENDER]
    (first, count), *_ = Counter(each[0] for each in words).most_common(1) or [("", 0)]
    shared = os.path.commonprefix([each for each in words if each[0] == first])
    return "_".join(shared) if 2 * count > len(names) else root.name


def _home(
    top: bpy.types.Collection, root: bpy.types.Object, items: Sequence[bpy.types.Object]
) -> bpy.types.Collection:
    """Return the collection in `top` of the group that the `root` of `items` is in, or a new one at
    its feet.
    """
    for child in top.children:
        if root in child.all_objects[:]:
            return child
    home = bpy.data.collections.new(name_of(root, items))
    home.instance_offset = place_of(root, filter(is_shape, items))
    if "stride" in root:
        home["stride"] = root["stride"]
    top.children.link(home)
    return home


def move_to(item: bpy.types.Object, home: bpy.types.Collection, scene: bpy.types.Scene) -> None:
    """Move `item` to the collection `home` from all others of the scene; it stays where it is."""
    if item in home.all_objects[:]:
        return
    home.objects.link(item)
    for other in {scene.collection, *scene.collection.children_recursive}.intersection(
        item.users_collection
    ) - {home}:
        other.objects.unlink(item)


def _bring(
    scene: bpy.types.Scene,
    top: bpy.types.Collection,
    home: bpy.types.Collection,
    instance: bpy.types.Object,
) -> bpy.types.Collection:
    """Make the instanced collection `home` one of the characters; return it, or its override."""
    if home.library:
        home = home.override_hierarchy_create(
            scene, bpy.context.view_layer, reference=instance, do_fully_editable=True
        )
        for other in {scene.collection, *scene.collection.children_recursive} - {top}:
            if home in other.children[:]:
                other.children.unlink(home)
    if home not in top.children[:]:
        top.children.link(home)
    return home


def _instance_notes(reading: Reading) -> Iterator[str]:
    instances = [item for item in reading.instanced.values() if item.name in bpy.data.objects]
    if instances:
        yield f"Still in the scene, as one more each: {_listed(instances)}."


def _listed(objects: Iterable[bpy.types.ID]) -> str:
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
        yield f"Not included: {_listed(left - instances)}."
    if inner := instances.difference(selected):
        yield (
            f"Instances of collections, left until you make them real (Object > Apply): "
            f"{_listed(inner)}."
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

    reading: EnumProperty(
        name="Read As",
        items=(
            (
                "LISTED",
                "As Listed",
                "A rig with its meshes, or loose parts that lie in one another",
            ),
            ("ONE", "One Character", "All that is selected together"),
            ("EACH", "One Each", "Each rig with its meshes, and each other mesh alone"),
        ),
        default="LISTED",
        description="What of the selection is a character",
    )

    @classmethod
    def poll(cls, context) -> bool:
        cls.poll_message_set("Select the characters first: their rigs or meshes")
        return any(
            item.type in ("ARMATURE", "EMPTY", *GEOMETRY) for item in context.selected_objects
        )

    def invoke(self, context, event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context) -> None:
        self.layout.prop(self, "reading", expand=True)
        lines = list(read_selection(context.scene, context.selected_objects, self.reading).lines())
        for line in lines[:MOST_LINES]:
            self.layout.label(text=line, translate=False)
        if len(lines) > MOST_LINES:
            self.layout.label(text=f"and {len(lines) - MOST_LINES} more", translate=False)

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
        reading = read_selection(scene, selected, self.reading)
        moved = {
            root: items
            for root, items in reading.characters.items()
            if not any(map(is_fixed, items))
        }
        notes = list(_notes(selected, reading.characters, moved))
        if not moved and not reading.instanced:
            raise CrowdError(
                " ".join(["Nothing selected is a rig with meshes, or a mesh with faces.", *notes])
            )
        if top is None:
            top = scene.crowd_lod.characters = bpy.data.collections.new("Characters")
        if top not in scene.collection.children_recursive:
            scene.collection.children.link(top)
        first_crowd(scene.crowd_lod)
        homes = {root: _home(top, root, items) for root, items in moved.items()}
        for root, items in moved.items():
            for item in items:
                move_to(item, homes[root], scene)
        brought = [_bring(scene, top, *pair) for pair in reading.instanced.items()]
        finest = [*(homes[group.owner] for group in Reading(moved, {}).groups()), *brought]
        walks = [
            note
            for root, items in moved.items()
            for note in take_walks(scene, homes[root].name, items)
        ]
        notes = [*walks, *_given_notes(scene, top, moved), *_instance_notes(reading), *notes]
        return " ".join([f"Added {_listed(finest)} to the collection {top.name}.", *notes])


CLASSES = (CROWDLOD_OT_characters_from_selection,)
