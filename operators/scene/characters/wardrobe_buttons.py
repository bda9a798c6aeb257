"""Make Slot and Mark as Prop: only some of a group's agents have the selected objects."""

from collections.abc import Sequence
from typing import Any

import bpy

from ....crowd_lod.errors import CrowdError
from ...blender import removal
from ...blender.character_objects import PROP
from ...blender.labeled_properties import FloatProperty, StringProperty
from ...blender.operator import Reporting
from ...settings import needs
from .characters import all_characters, groups_in
from .given_lods import CharacterGroup
from .wardrobe import EXCLUDES, NONE, PREFIX, SHARE, SLOT, Owner, members_of, slots_in


def props_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the props of all character groups of `scene`, sorted by name."""
    top = scene.crowd_lod.characters
    members = (
        {item for group in groups_in(scene, top) for item in group.members if PROP in item}
        if top is not None
        else set()
    )
    return sorted(members, key=lambda item: item.name.casefold())


def mark(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], chance: float) -> None:
    """Mark `objects` as props that agents have by `chance`.

    CrowdError, and nothing is marked, if one cannot be.
    """
    before = {item: item.get(PROP) for item in objects}
    try:
        for item in objects:
            item[PROP] = chance
            item.id_properties_ui(PROP).update(
                min=0.0, max=1.0, description="Chance that an agent has this prop"
            )
        all_characters(scene)
    except CrowdError:
        for item, value in before.items():
            _set(item, PROP, value)
        raise


def make_slot(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], name: str, none: float
) -> str:
    """Put `objects`, of one character group, in its slot `name`; return a sentence.

    none: the share of the agents without, where the slot is new.
    CrowdError, and nothing has changed, if they cannot be worn.
    """
    owner = _group_with(scene, objects).owner
    if owner.library or owner.override_library:
        raise CrowdError(f"{owner.name} is of another file: make the slot {name} there.")
    home = slots_in(owner).get(name)
    before = {item: list(item.users_collection) for item in objects}
    new = home is None
    if home is None:
        home = bpy.data.collections.new(PREFIX + " " + name)
        owner.children.link(home)
        home[NONE] = none
    try:
        for item in objects:
            _move(item, [home])
        all_characters(scene)
    except CrowdError:
        for item, homes in before.items():
            _move(item, homes)
        if new:
            removal.remove([home])
        raise
    _offer_values(home)
    names = ", ".join(sorted(item.name for item in objects))
    return f"{names}: in the slot {name} of {owner.name}. Press Populate."


def make_slot_of(
    scene: bpy.types.Scene, home: bpy.types.Collection | None, name: str, none: float
) -> str:
    """Make the collection `home`, inside a character group's, its slot `name`; return a sentence.

    Each of its child collections and objects is a part. The other arguments, errors: see make_slot.
    """
    owners = (group.owner for group in groups_in(scene, scene.crowd_lod.characters))
    collections = (owner for owner in owners if isinstance(owner, bpy.types.Collection))
    owner = next((owner for owner in collections if home in owner.children_recursive), None)
    if owner is None:
        raise CrowdError(
            "Select objects of one character group first, hats, say, of which an agent wears one; "
            "or make a collection active that lies in a group's and holds them."
        )
    before = {key: home.get(key) for key in (SLOT, NONE)}
    try:
        home[SLOT] = name or home.name
        home[NONE] = none
        all_characters(scene)
    except CrowdError:
        for key, value in before.items():
            _set(home, key, value)
        raise
    _offer_values(home)
    return f"{home.name} is a slot of {owner.name}. Press Populate."


def _offer_values(home: bpy.types.Collection) -> None:
    """Give the slot and its parts the custom properties that the sidebar shows."""
    _offer(home, NONE, 0.0, "Share of the agents without a part of this slot")
    _offer(home, EXCLUDES, "", "Slots that its wearers go without, by commas")
    for part, _ in members_of(home):
        _offer(part, SHARE, 1.0, "Share of the agents, in proportion to the others of its slot")
        _offer(part, EXCLUDES, "", "Slots that its wearers go without, by commas")


def _group_with(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> CharacterGroup:
    """Return the group, in a collection of its own, that all objects are of."""
    for group in groups_in(scene, scene.crowd_lod.characters):
        if set(objects) <= set(group.members):
            if isinstance(group.owner, bpy.types.Collection):
                return group
            raise CrowdError(
                f"The character {group.owner.name} lies in no collection of its own: put it in "
                f"one, inside {scene.crowd_lod.characters.name}."
            )
    raise CrowdError("Select objects of one character group alone: a slot is of one.")


def _move(item: bpy.types.Object, homes: Sequence[bpy.types.Collection]) -> None:
    for home in item.users_collection:
        if home not in homes:
            home.objects.unlink(item)
    for home in homes:
        if item not in home.objects[:]:
            home.objects.link(item)


def _set(owner: Owner, name: str, value: Any) -> None:
    """Give `owner` its custom property back as it was: None stands for none."""
    if value is None:
        owner.pop(name, None)
    else:
        owner[name] = value


def _offer(owner: Owner, name: str, value: float | str, description: str) -> None:
    """Give `owner` a custom property that the sidebar can show, if it has none."""
    if name not in owner:
        owner[name] = value
    limits = {} if isinstance(value, str) else {"min": 0.0, "soft_max": 10.0}
    owner.id_properties_ui(name).update(description=description, **limits)


class CROWDLOD_OT_mark_as_prop(Reporting, bpy.types.Operator):
    bl_description = (
        "Give the selected objects of character groups, and their children, to only some of the "
        "agents"
    )
    bl_idname = "crowd_lod.mark_as_prop"
    bl_label = "Mark as Prop"
    needs = (needs.characters,)

    chance: FloatProperty(
        name="Chance",
        default=0.5,
        min=0,
        max=1,
        subtype="FACTOR",
        description="That an agent has the prop; with 1 all have it",
    )

    def run(self, context) -> str:
        scene = context.scene
        members = {
            item for group in groups_in(scene, scene.crowd_lod.characters) for item in group.members
        }
        props = [
            item for item in context.selected_objects if item in members and item.library is None
        ]
        if not props:
            raise CrowdError(
                "Select an object of a character group first: one that only some of its agents "
                "are to have."
            )
        mark(scene, props, round(self.chance, 6))
        names = ", ".join(sorted(item.name for item in props))
        return f"{self.chance:.0%} of the agents will have {names}: press Populate."


class CROWDLOD_OT_make_slot(Reporting, bpy.types.Operator):
    bl_description = (
        "Put the selected objects of a character group in a slot: each agent wears one of them, or "
        "none. With nothing selected, make the active collection a slot"
    )
    bl_idname = "crowd_lod.make_slot"
    bl_label = "Make Slot"
    needs = (needs.characters,)

    slot: StringProperty(
        name="Slot", description="Its name, such as hat; if empty, that of what is in it"
    )
    none: FloatProperty(
        name="None",
        default=1,
        min=0,
        soft_max=10,
        description="Share of the agents without, where each part has a share of 1",
    )

    def invoke(self, context, event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self)

    def run(self, context) -> str:
        objects = [
            item
            for item in context.selected_objects
            if item.type != "ARMATURE" and item.library is None
        ]
        scene = context.scene
        name = self.slot.strip()
        none = round(self.none, 6)
        if not objects:
            return make_slot_of(scene, context.collection, name, none)
        return make_slot(scene, objects, name or objects[0].name, none)


CLASSES = (CROWDLOD_OT_mark_as_prop, CROWDLOD_OT_make_slot)
