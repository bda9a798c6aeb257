"""The character groups of a scene, and the variants that their props make of them."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import bpy

from ...crowd_lod.crowd.agents import MOST_GROUPS, Group
from ...crowd_lod.errors import CrowdError
from ..blender import stored_values
from ..blender.character_objects import WITHOUT_FACES, is_stage, may_have_faces, parts
from ..blender.ownership import OWNED
from ..blender.props import Variant, variants_of
from ..blender.references import closure_of
from ..machine import terrain_source
from .given_lods import CharacterGroup, GivenLod, Owner, with_given_lods
from .wardrobe import parts_of, slots_in

# custom property of a LOD's collection of one character group: the group's name
GROUP = "crowd_lod_group"
FINE = 1e-5  # of a chance: Blender keeps float32


class Character(NamedTuple):
    """A character group, or a variant of one.

    objects: those with a shape.
    origin: world meters.
    variant_of: the group's name, "" for the variant without props.
    chance: that an agent of the group is this variant.
    given: LODs that an artist made of it, the finer ones first.
    slot, excludes: of a part that agents wear, see wardrobe.Part; of others "" and none.
    """

    name: str
    objects: list[bpy.types.Object]
    origin: tuple[float, float, float]
    variant_of: str
    chance: float
    given_lods: tuple[GivenLod, ...] = ()
    slot: str = ""
    excludes: tuple[str, ...] = ()


def characters_of(
    scene: bpy.types.Scene,
) -> list[tuple[str, list[bpy.types.Object], tuple[float, float, float]]]:
    """Return (name, objects, origin) of each of `all_characters`."""
    return [character[:3] for character in all_characters(scene)]


def all_characters(scene: bpy.types.Scene) -> list[Character]:
    """Return the character groups of `scene`, sorted by name, each with its variants, then parts.

    A group is a child collection of the characters' collection, or one of its objects with all that
    is parented to it. What is_stage is left out. CrowdError if there is no usable group.
    """
    stored_values.check(scene.crowd_lod)
    top = scene.crowd_lod.characters
    if top is None:
        raise CrowdError(
            f"The scene {scene.name} has no characters: choose a collection in the Crowd panel "
            f"whose children are the characters."
        )
    groups = sorted(groups_in(scene, top), key=lambda group: group.owner.name.casefold())
    if not groups:
        state = "holds lamps, cameras and empties alone" if top.all_objects else "is empty"
        raise CrowdError(
            f"The collection {top.name} {state}: put the characters in it, one child collection "
            f"or object each."
        )
    cast = []
    for group in groups:
        cast += _family(top, group)
    names = [character.name for character in cast]
    for name in names:
        if names.count(name) > 1:
            raise CrowdError(
                f"Two character groups in {top.name} are called {name}: rename one of them."
            )
    if len(cast) > MOST_GROUPS:
        raise CrowdError(
            f"The collection {top.name} holds {len(cast)} character groups; use at most "
            f"{MOST_GROUPS}."
        )
    return cast


def _family(top: bpy.types.Collection, group: CharacterGroup) -> Iterator[Character]:
    """Yield a character group in `top`: its variants by props, then the parts that agents wear."""
    name = group.owner.name
    slots = slots_in(group.owner)
    worn = {item for home in slots.values() for item in home.all_objects}
    worn |= {child for item in worn for child in item.children_recursive}
    members = [item for item in group.members if item not in worn]
    lods = [
        {
            variant.name: variant
            for variant in _variants(
                top, group.owner, [item for item in lod.objects if item not in worn]
            )
        }
        for lod in group.lods
    ]
    bodies = _variants(top, group.owner, members)
    for variant in bodies:
        given = tuple(
            GivenLod(variants[variant.name].objects, lod.offset)
            for lod, variants in zip(group.lods, lods, strict=True)
            if variant.name in variants  # else its props are others
        )
        variant_of = name if variant.name != name else ""
        yield Character(*variant[:2], group.origin, variant_of, variant.chance, given)
    if slots:
        shapes = parts(group.owner, group.members)
        for part in parts_of(group.owner, slots, shapes, bodies[0].objects):
            yield Character(
                part.name,
                part.objects,
                group.origin,
                name,
                part.chance,
                slot=part.slot,
                excludes=part.excludes,
            )


def _variants(
    top: bpy.types.Collection, owner: Owner, members: list[bpy.types.Object]
) -> list[Variant]:
    """Return the variants of a character in `top`, or of a LOD of it.

    CrowdError if it has no mesh.
    """
    shapes = parts(owner, members)
    if not any(map(may_have_faces, shapes)):
        raise CrowdError(
            f"The character group {owner.name} in {top.name} holds no mesh with faces: give it "
            f"one, or take it out."
        )
    return list(variants_of(owner.name, members, shapes))


def groups_in(scene: bpy.types.Scene, top: bpy.types.Collection) -> list[CharacterGroup]:
    """Return the groups in the characters' collection `top`."""
    return with_given_lods(list(_groups_as_they_lie(scene, top)))


def _groups_as_they_lie(
    scene: bpy.types.Scene, top: bpy.types.Collection
) -> Iterator[tuple[Owner, list[bpy.types.Object], tuple]]:
    """Yield (owner, objects, origin) of each child of `top`; LODs of one may be several."""
    settings = scene.crowd_lod
    ground = terrain_source.grounds_of([settings, *settings.crowds])
    for child in top.children:
        if not is_stage(child.all_objects) and not ground.issuperset(child.all_objects[:] or [top]):
            yield child, list(child.all_objects), tuple(child.instance_offset)
    own = set(top.objects)
    for root in top.objects:
        if root.parent not in own:
            # LODs hang on the same armature
            members = [root, *(item for item in root.children_recursive if not item.get(OWNED))]
            if not is_stage(members) and root not in ground:
                yield root, members, tuple(root.matrix_world.translation)


def notes_on_left_out(scene: bpy.types.Scene) -> Iterator[str]:
    """Yield a sentence on what renders show of the characters and no crowd does, because it has no
    faces.
    """
    members = [
        item for group in groups_in(scene, scene.crowd_lod.characters) for item in group.members
    ]
    names = [
        f"{item.name} ({WITHOUT_FACES[item.type]})"
        for item in members
        if item.type in WITHOUT_FACES and not item.hide_render
    ]
    if names:
        yield (
            f"Left out of the crowd, which shows faces and hair: {', '.join(sorted(names))}. "
            f"Convert to meshes what is needed."
        )


def notes_on_unsaved(scene: bpy.types.Scene) -> Iterator[str]:
    """Yield a sentence on objects that the characters are made of and that Blender drops when it
    saves the file.
    """
    shapes = [item for _, objects, _ in characters_of(scene) for item in objects]
    names = sorted(
        item.name for item in closure_of(shapes) if not item.users and item.library is None
    )
    if names:
        yield (
            f"No collection holds {', '.join(names)}, on which the characters depend: Blender "
            f"does not save such objects, so link "
            "them to a collection."
        )


def check_measured(cast: Sequence[tuple], groups: Sequence[Group]) -> None:
    """Raise CrowdError if `cast`, the scene's characters, are others than the measured groups."""
    if [each[0] for each in cast] != [group.name for group in groups]:
        raise CrowdError(
            "The character groups, their props or slots have changed: press Populate, then Make "
            "LOD Meshes."
        )


def props_outdated(scene: bpy.types.Scene) -> Iterator[str]:
    """Yield a sentence if the props are others, or have other chances, than when the scene was
    populated.
    """
    groups = scene.crowd_lod.groups
    with suppress(CrowdError):  # Populate tells
        cast = all_characters(scene) if len(groups) else []
        now = {character.name: character.chance for character in cast if character.variant_of}
        before = {group.name: group.chance for group in groups if group.variant_of}
        slots = {group.name: (group.slot, group.excludes) for group in groups}
        other_slots = any(
            slots.get(character.name, ("", "")) != (character.slot, ", ".join(character.excludes))
            for character in cast
        )
        if (
            other_slots
            or now.keys() != before.keys()
            or any(abs(now[name] - before[name]) > FINE for name in now)
        ):
            yield "The characters' props or slots have changed: press Populate."
