"""The slots of a character group, and the parts in them that its agents wear.

A slot is a collection inside the group's, whose name begins with "slot:" or which has the custom
property "slot". Its child collections are its parts, and each of its objects with what is parented
to it. A prop is a slot of one part.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import bpy

from ....crowd_lod.errors import CrowdError
from ...blender import stored_values
from ...blender.animation import armatures_of
from ...blender.character_objects import JOINT, PROP, may_have_faces, prop_of

SLOT = "slot"  # custom property of a collection: the slot's name
PREFIX = "slot:"  # begins the name of such a collection in its place
SHARE = "share"  # custom property of a part: its share of the agents, 1 without
NONE = "none"  # custom property of a slot: the share of the agents without a part, 0 without
EXCLUDES = "excludes"  # custom property of a slot or a part: names of slots, by commas
MOST_SHARE = 1e6

Owner = bpy.types.Collection | bpy.types.Object


class Part(NamedTuple):
    """What some agents of a group wear.

    name: the group's, then the part's.
    objects: with a shape.
    slot: the slot's name.
    chance: that it is drawn in its slot.
    excludes: the slots that go without, where it is worn.
    """

    name: str
    objects: list[bpy.types.Object]
    slot: str
    chance: float
    excludes: tuple[str, ...]


def slots_in(owner: Owner) -> dict[str, bpy.types.Collection]:
    """Return the slots of a character group by name, sorted; CrowdError if two are called alike."""
    slots: dict[str, bpy.types.Collection] = {}
    inside = owner.children_recursive if isinstance(owner, bpy.types.Collection) else ()
    for home in inside:
        name = _slot_name(home)
        if name in slots:
            raise CrowdError(
                f"The character group {owner.name} has two slots called {name}, {home.name} and "
                f"{slots[name].name}: rename one, or put what is in them together."
            )
        if name:
            slots[name] = home
    return dict(sorted(slots.items()))


def _slot_name(home: bpy.types.Collection) -> str:
    """Return the name of the slot that the collection is; "" if it is none."""
    name = home.get(SLOT, "")
    if not isinstance(name, str):
        raise CrowdError(
            f'The custom property "{SLOT}" of {home.name} is {name!r}: give it the name of the '
            f"slot, such as hat, or remove it."
        )
    if not name and home.name.casefold().startswith(PREFIX):
        # Blender numbers collections of one name
        name = re.sub(r"\.\d{3,}$", "", home.name[len(PREFIX) :])
    return name.strip()


def wardrobe_of(
    owner: Owner, members: Sequence[bpy.types.Object], shapes: Sequence[bpy.types.Object]
) -> tuple[list[bpy.types.Object], list[Part]]:
    """Return (body, parts): what all agents of the character group have, and what some wear.

    members: all of its objects.
    shapes: those that have a shape and are shown.

    CrowdError if a slot or a part cannot be used.
    """
    slots = slots_in(owner)
    in_slots = {item for home in slots.values() for item in home.all_objects}
    in_slots |= {child for item in in_slots for child in item.children_recursive}
    parts = [part for slot, home in slots.items() for part in _parts_in(owner, slot, home, shapes)]
    props = _props_of(owner, [item for item in members if item not in in_slots], shapes)
    optional = {prop: chance for prop, chance in props.items() if 0 < chance < 1}
    for prop in optional:
        if prop.name in slots:
            raise CrowdError(
                f"The character group {owner.name} has a prop and a slot called {prop.name}: "
                f"rename one."
            )
    parts += [_part_of(owner, prop, chance, shapes) for prop, chance in optional.items()]
    body = [item for item in shapes if item not in in_slots and props.get(prop_of(item), 1.0) == 1]
    if not any(map(may_have_faces, body)):
        raise CrowdError(
            f"All meshes of the character group {owner.name} are props or in slots: keep one "
            f"that all its agents have."
        )
    homes = slots | {prop.name: prop for prop in optional}
    _check_exclusions(owner, dict(sorted(homes.items())), parts)
    _check_rigs(owner, body, parts)
    return body, parts


def _check_rigs(owner: Owner, body: Sequence[bpy.types.Object], parts: Sequence[Part]) -> None:
    """Raise CrowdError if the rig of the body does not move a part."""
    rigs = armatures_of(list(body))
    for part in parts:
        if rigs and not set(rigs) & set(_rigs_of(part.objects)):
            raise CrowdError(
                f"The part {part.name} is not moved by {rigs[0].name}, the rig of {owner.name}: "
                f"parent it to that rig, or give it an Armature modifier."
            )


def _props_of(
    owner: Owner, members: Sequence[bpy.types.Object], shapes: Sequence[bpy.types.Object]
) -> dict[bpy.types.Object, float]:
    """Return the chance of each prop among `members`, by name."""
    remedy = "set the chance that an agent has this prop, or remove it"
    props = sorted(
        (item for item in members if PROP in item and not item.hide_render),
        key=lambda item: item.name,
    )
    chances = {
        item: round(float(stored_values.read(item, PROP, float, remedy, bounds=(0, 1))), 6)
        for item in props
    }
    with_faces = {prop_of(item) for item in shapes if may_have_faces(item)}
    outermost = [item for item in props if prop_of(item) is item]
    for prop in outermost:
        if prop not in with_faces:
            raise CrowdError(
                f"The prop {prop.name} of the character group {owner.name} has no mesh with "
                f'faces: give it one, or remove its custom property "{PROP}".'
            )
    return {prop: chances[prop] for prop in outermost}


def _part_of(
    owner: Owner, prop: bpy.types.Object, chance: float, shapes: Sequence[bpy.types.Object]
) -> Part:
    """Return the part that a prop is, alone in a slot of its name."""
    objects = [item for item in shapes if prop_of(item) is prop]
    return Part(
        JOINT.join([owner.name, prop.name]), objects, prop.name, chance, tuple(_names(prop))
    )


def _check_exclusions(owner: Owner, slots: dict[str, Owner], parts: Sequence[Part]) -> None:
    """Raise CrowdError if a part excludes a slot that is not there, or a slot is never worn."""
    for part in parts:
        for other in part.excludes:
            if other not in slots or other == part.slot:
                raise CrowdError(
                    f"The part {part.name} excludes the slot {other}: of {owner.name} name one or "
                    f"more of {', '.join(name for name in slots if name != part.slot) or 'none'}."
                )
    for rival, home in slots.items():
        worn = [part for part in parts if part.slot == rival]
        if sum(part.chance for part in worn) > 1 - 1e-6:  # by all agents
            excluded = set.intersection(*(set(part.excludes) for part in worn))
            if excluded:
                raise CrowdError(
                    f"No agent can wear the slot {min(excluded)} of {owner.name}: all agents wear "
                    f"a part of the slot {rival}, and all of these exclude it. Give {home.name} a "
                    f'share without in its custom property "{NONE}".'
                )


def _rigs_of(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the armatures that move the objects, or what these are parented to."""
    moved = list(objects)
    for item in moved:
        if item.parent is not None and item.parent not in moved:
            moved.append(item.parent)
    return armatures_of(moved)


def members_of(home: bpy.types.Collection) -> list[tuple[Owner, list[bpy.types.Object]]]:
    """Return (what names it, its objects) of each part of the slot `home`."""
    direct = home.objects[:]
    roots = [item for item in direct if item.parent not in direct and item.type != "ARMATURE"]
    return [
        *((child, list(child.all_objects)) for child in home.children),
        *((root, [root, *root.children_recursive]) for root in roots),
    ]


def _parts_in(
    owner: Owner,
    slot: str,
    home: bpy.types.Collection,
    shapes: Sequence[bpy.types.Object],
) -> Iterator[Part]:
    worn = [
        (part, [item for item in objects if item in shapes]) for part, objects in members_of(home)
    ]
    worn = [(part, objects) for part, objects in worn if any(map(may_have_faces, objects))]
    if not worn:
        raise CrowdError(
            f"The slot {slot} of {owner.name} is empty: put a mesh with faces in {home.name}, or "
            f"take that collection out."
        )
    shares = [_number(part, SHARE, 1.0) for part, _ in worn]
    whole = sum(shares) + _number(home, NONE, 0.0)
    if not sum(shares):
        raise CrowdError(
            f"The shares of the slot {slot} of {owner.name} are all 0: give one of its parts a "
            f'custom property "{SHARE}" above 0.'
        )
    for (part, objects), share in zip(worn, shares, strict=True):
        if share:
            name = JOINT.join([owner.name, part.name])
            excludes = tuple(sorted({*_names(home), *_names(part)}))
            yield Part(name, objects, slot, share / whole, excludes)


def _number(owner: Owner, name: str, default: float) -> float:
    if name not in owner:
        return default
    remedy = "set a share, in proportion to the others of its slot, or remove it"
    value = stored_values.read(owner, name, float, remedy, bounds=(0, MOST_SHARE))
    return round(float(value), 6)


def _names(owner: Owner) -> list[str]:
    """Return the names of slots that the slot or part `owner` excludes."""
    text = owner.get(EXCLUDES, "")
    if not isinstance(text, str):
        raise CrowdError(
            f'The custom property "{EXCLUDES}" of {owner.name} is {text!r}: give it names of '
            f"slots, by commas, or remove it."
        )
    return [name.strip() for name in text.split(",") if name.strip()]
