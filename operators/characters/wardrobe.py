"""The slots of a character group, and the parts in them that its agents wear.

A slot is a collection inside the group's, whose name begins with "slot:" or which has the custom
property "slot". Its child collections are its parts, and each of its objects with what is parented
to it.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender import stored_values
from ..blender.animation import armatures_of
from ..blender.character_objects import may_have_faces
from ..blender.props import JOINT

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


def parts_of(
    owner: Owner,
    slots: dict[str, bpy.types.Collection],
    shapes: Sequence[bpy.types.Object],
    body: Sequence[bpy.types.Object],
) -> Iterator[Part]:
    """Yield the parts in the `slots` of the character group `owner`.

    shapes: all of its objects that have a shape and are shown.
    body: those that all its agents have.

    CrowdError if a slot or a part cannot be used.
    """
    never_none = {}
    parts = []
    for slot, home in slots.items():
        worn = list(_parts_in(owner, slot, home, shapes))
        parts += worn
        never_none[slot] = sum(part.chance for part in worn) > 1 - 1e-6
    for part in parts:
        for other in part.excludes:
            if other not in slots or other == part.slot:
                raise CrowdError(
                    f"The part {part.name} excludes the slot {other}: of {owner.name} name one or "
                    f"more of {', '.join(name for name in slots if name != part.slot) or 'none'}."
                )
    for slot in slots:
        rivals = [
            other
            for other in slots
            if never_none[other]
            and all(slot in part.excludes for part in parts if part.slot == other)
        ]
        if rivals:
            raise CrowdError(
                f"Nobody can wear the slot {slot} of {owner.name}: all agents wear a part of the "
                f"slot {rivals[0]}, and all of these exclude it. Give {slots[rivals[0]].name} a "
                f'share without in its custom property "{NONE}".'
            )
    rigs = armatures_of(list(body))
    for part in parts:
        if rigs and not set(rigs) & set(_rigs_of(part.objects)):
            raise CrowdError(
                f"The part {part.name} is not moved by {rigs[0].name}, the rig of {owner.name}: "
                f"parent it to that rig, or give it an Armature modifier."
            )
    yield from parts


def _rigs_of(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the armatures that move the objects, or what these are parented to."""
    moved = list(objects)
    for item in moved:
        if item.parent is not None and item.parent not in moved:
            moved.append(item.parent)
    return armatures_of(moved)


def _parts_in(
    owner: Owner,
    slot: str,
    home: bpy.types.Collection,
    shapes: Sequence[bpy.types.Object],
) -> Iterator[Part]:
    members: list[tuple[Owner, list[bpy.types.Object]]] = [
        (child, list(child.all_objects)) for child in home.children
    ]
    direct = home.objects[:]
    roots = [item for item in direct if item.parent not in direct and item.type != "ARMATURE"]
    members += [(root, [root, *root.children_recursive]) for root in roots]
    worn = [(part, [item for item in objects if item in shapes]) for part, objects in members]
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
